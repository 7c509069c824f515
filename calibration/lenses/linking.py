"""First poses of all shots, lenses and boards in one frame, from the pose of each board in front of each lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from calibration.lenses.problem import BoardView
from palletloc.errors import PalletLocError

_Placed = tuple[str, int]
"""What has a place: a lens, a shot or a board, by its number."""


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
    known: dict[_Placed, RigidTransform] = {
        ("lens", 0): RigidTransform.identity(),
        ("board", 0): RigidTransform.identity(),
    }
    for _ in range(count + lenses + boards):
        before = len(known)
        for view, pose in zip(views, poses, strict=True):
            known |= _followed(view, pose, known)
        if len(known) == before:
            break
    sizes = (("lens", lenses), ("shot", count), ("board", boards))
    stacks = [[known.get((kind, i)) for i in range(size)] for kind, size in sizes]
    if None in stacks[0]:
        raise UnlinkedError("no shot shows one board through both lenses, nor boards that stand still")
    if None in stacks[1] or None in stacks[2]:
        raise UnlinkedError("some boards are never seen together with the others, so their places are open")
    return Linked(*(RigidTransform.concatenate([pose for pose in stack if pose is not None]) for stack in stacks))


def _followed(
    view: BoardView, pose: RigidTransform, known: Mapping[_Placed, RigidTransform]
) -> dict[_Placed, RigidTransform]:
    """Return the one pose of three that a view's own pose gives, where the other two are known."""
    places: tuple[_Placed, _Placed, _Placed] = (("lens", view.lens), ("shot", view.shot), ("board", view.board))
    match tuple(known.get(place) for place in places):
        case (RigidTransform() as lens, None, RigidTransform() as board):
            return {places[1]: lens * pose * board.inv()}
        case (None, RigidTransform() as shot, RigidTransform() as board):
            return {places[0]: shot * board * pose.inv()}
        case (RigidTransform() as lens, RigidTransform() as shot, None):
            return {places[2]: shot.inv() * lens * pose}
    return {}
