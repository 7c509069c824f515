"""First poses of all shots, lenses and boards in one frame, from the pose of each board in front of each lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from calibration.lenses.problem import BoardView
from palletloc.errors import PalletLocError


class UnlinkedError(PalletLocError):
    """Lenses or boards that no shot brings together."""


@dataclass(frozen=True, slots=True, eq=False)
class Linked:
    """Poses in the frame of the first lens."""

    lenses: RigidTransform
    """Stack of ``camera_from_lens``."""
    shots: RigidTransform
    """Stack of ``camera_from_world``."""
    boards: RigidTransform
    """Stack of ``world_from_board``."""


def link(views: Sequence[BoardView], poses: Sequence[RigidTransform], lenses: int, boards: int) -> Linked:
    """Return the poses that follow from one another, beginning at the first lens and the first board.

    Parameters
    ----------
    views : sequence of BoardView
        Numbered without gaps.
    poses : sequence of RigidTransform
        ``lens_from_board`` of each view.
    lenses, boards : int
        How many there are.

    Raises
    ------
    UnlinkedError
        If some of them have nothing in common with the rest.
    """
    count = max(view.shot for view in views) + 1
    lens: list[RigidTransform | None] = [RigidTransform.identity(), *[None] * (lenses - 1)]
    shot: list[RigidTransform | None] = [None] * count
    board: list[RigidTransform | None] = [RigidTransform.identity(), *[None] * (boards - 1)]
    for _ in range(count + lenses + boards):
        followed = [_follow(view, pose, lens, shot, board) for view, pose in zip(views, poses, strict=True)]
        if not any(followed):
            break
    if None in lens:
        raise UnlinkedError("no shot shows one board through both lenses, nor boards that stand still")
    if None in shot or None in board:
        raise UnlinkedError("some boards are never seen together with the others, so their places are open")
    return Linked(_stacked(lens), _stacked(shot), _stacked(board))


def _stacked(poses: Sequence[RigidTransform | None]) -> RigidTransform:
    return RigidTransform.concatenate([pose for pose in poses if pose is not None])


def _follow(
    view: BoardView,
    pose: RigidTransform,
    lenses: list[RigidTransform | None],
    shots: list[RigidTransform | None],
    boards: list[RigidTransform | None],
) -> bool:
    """Fill in the one pose of three that a view's own pose gives; return whether there was such a one."""
    match lenses[view.lens], shots[view.shot], boards[view.board]:
        case (RigidTransform() as lens, None, RigidTransform() as board):
            shots[view.shot] = lens * pose * board.inv()
        case (None, RigidTransform() as shot, RigidTransform() as board):
            lenses[view.lens] = shot * board * pose.inv()
        case (RigidTransform() as lens, RigidTransform() as shot, None):
            boards[view.board] = shot.inv() * lens * pose
        case _:
            return False
    return True
