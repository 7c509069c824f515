"""From shots to corners of boards, lens by lens; shots that are there twice count once."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearings import pose_from_bearings
from calibration.intrinsics.corner_file import read_corners
from calibration.intrinsics.missing_boards import why_no_board
from calibration.intrinsics.task import Chessboard, CodedBoard, IntrinsicsTask
from calibration.lenses.problem import BoardView
from calibration.targets.board_detection import SCALES, Marker, detect_markers
from calibration.targets.chessboard import find_chessboard
from calibration.targets.targets import PrintedPattern, border_of, on_board, patterns
from calibration.targets.texture_alignment import AlignedCorners, align_corners
from palletloc.cameras import CameraModel, KannalaBrandt
from palletloc.geometry import FloatArray, Image
from palletloc.io.images import read_image
from palletloc.io.reading import read_bytes

_SAME_PX = 1e-3
"""Views are twins whose corners differ by less: two exposures differ by more, by noise alone."""
_CHESSBOARD_SIGMA_PX = 0.03
"""The chessboard detector's corners are not better than this; the fit says how much worse."""
_FOCAL_GUESS, _FAR = 0.4, 100.0
"""Of a lens that is not known, as a part of its width; and where markers are put along their bearings, in metres."""
_MARKER_SIGMA_PX, _FEWEST_MARKERS = 0.3, 3
"""Standard deviation of markers' corners, in pixels; and the fewest markers that tell a board's layout."""
_ASKED = 3
"""Shots without a board that are looked at again for the reason, while there is none in any shot."""
_WIDEST = float(np.radians(115.0))
"""Largest angle off axis of a lens that is not known, in radians: enough for lenses that overlap in pairs."""


@dataclass(frozen=True, slots=True, eq=False)
class Collected:
    """What the shots show."""

    views: tuple[BoardView, ...] = ()
    """Each board in each shot through each lens."""
    duplicates: tuple[tuple[str, str], ...] = ()
    """Views that are the same as an earlier one, with that one."""
    empty: tuple[str, ...] = ()
    """Shots without a board."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why some of them have none."""
    patterns: Mapping[str, PrintedPattern] = field(default_factory=dict)
    """Of the ChArUco boards, by view."""
    shots: Mapping[str, str] = field(default_factory=dict)
    """The shot of each view."""


class _SeenBoard(NamedTuple):
    """A board in a shot."""

    view: BoardView
    pattern: PrintedPattern | None


def collect(task: IntrinsicsTask, on_progress: Callable[[str], None] = lambda _: None) -> Collected:
    """Find the boards in all shots, or read them from the file of corners.

    Parameters
    ----------
    task : IntrinsicsTask
        What to read.
    on_progress : callable
        Is told what is done next.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong.
    """
    if task.corners is not None:
        found = Collected(tuple(read_corners(task.corners, task.size, task.lenses, fixed=task.boards_stand_still)))
    else:
        found = _from_shots(task, on_progress)
    kept: list[BoardView] = []
    twins: list[tuple[str, str]] = []
    for view in found.views:
        twin = next((earlier for earlier in kept if _same(earlier, view)), None)
        if twin is None:
            kept.append(view)
        else:
            twins.append((view.name, twin.name))
    return replace(found, views=tuple(numbered_boards(kept)), duplicates=(*found.duplicates, *twins))


def _from_shots(task: IntrinsicsTask, on_progress: Callable[[str], None]) -> Collected:
    read: dict[str, str] = {}
    boards: dict[str, list[_SeenBoard]] = {}
    duplicates: list[tuple[str, str]] = []
    reasons: dict[str, str] = {}
    for shot in task.shots:
        path = task.folder / shot
        digest = hashlib.sha256(read_bytes(path)).hexdigest()
        if digest in read:
            duplicates.append((shot, read[digest]))
            continue
        read[digest] = shot
        on_progress(f"{shot}: looking for boards")
        image = read_image(path, task.size, gray=True)
        boards[shot] = [board for lens in range(task.lenses) for board in _in_lens(task, image, shot, lens)]
        if not boards[shot] and not any(boards.values()) and len(reasons) < _ASKED:
            reasons[shot] = why_no_board(image, task.boards, partial(_sees_markers, task, shot))
    return Collected(
        tuple(board.view for seen in boards.values() for board in seen),
        tuple(duplicates),
        tuple(shot for shot, seen in boards.items() if not seen),
        {shot: reason for shot, reason in reasons.items() if reason},
        {board.view.name: board.pattern for seen in boards.values() for board in seen if board.pattern is not None},
        {board.view.name: shot for shot, seen in boards.items() for board in seen},
    )


def _sees_markers(task: IntrinsicsTask, shot: str, image: Image) -> bool:
    """Return whether there is a board with markers in a shot."""
    coded = {name: board for name, board in task.boards.items() if not isinstance(board, Chessboard)}
    return any(True for lens in range(task.lenses) for _ in _coded_boards(task, image, shot, lens, coded))


def _in_lens(task: IntrinsicsTask, image: Image, shot: str, lens: int) -> Iterator[_SeenBoard]:
    """Yield the boards that one lens shows in a shot."""
    for name, board in task.boards.items():
        if isinstance(board, Chessboard):
            offset, part = _part(task, image, lens)
            corners = find_chessboard(part, board.columns, board.rows)
            if corners is not None:
                sigma = np.full(len(corners), _CHESSBOARD_SIGMA_PX)
                pixels = corners + np.array([offset, 0.0])
                yield _SeenBoard(BoardView(*_place(task, shot, name, lens), board.corners, pixels, sigma), None)
    coded = {name: board for name, board in task.boards.items() if not isinstance(board, Chessboard)}
    if coded:
        yield from _coded_boards(task, image, shot, lens, coded)


def _coded_boards(
    task: IntrinsicsTask, image: Image, shot: str, lens: int, boards: dict[str, CodedBoard]
) -> Iterator[_SeenBoard]:
    """Yield boards with the corners of their markers, which need no lens that is known well.

    They are measured again when it is.
    """
    camera = task.start_of_lens(lens) or _equidistant(task, lens)
    own = _own_part(task, image, lens)
    for family in sorted({(board.dictionary, border_of(board)) for board in boards.values()}):
        missing = {name: board for name, board in boards.items() if (board.dictionary, border_of(board)) == family}
        for scale in SCALES:
            markers = detect_markers(camera, own, family[0], scale, family[1]) if missing else []
            for name, board in list(missing.items()):
                seen = _marker_view(camera, markers, board, _place(task, shot, name, lens))
                if seen is not None:
                    del missing[name]
                    yield seen


def _marker_view(
    camera: CameraModel, markers: Sequence[Marker], board: CodedBoard, place: tuple[str, int, int, int]
) -> _SeenBoard | None:
    """Return the corners of a board's markers, and which of its layouts fits them; None where too few are seen."""
    counts = Counter(marker.id for marker in markers)
    best: tuple[float, _SeenBoard] | None = None
    for pattern in patterns(board):
        index = {int(number): i for i, number in enumerate(pattern.marker_ids)}
        once = [marker for marker in markers if marker.id in index and counts[marker.id] == 1]
        if len(once) < _FEWEST_MARKERS:
            return None
        points = on_board(pattern.marker_corners[[index[marker.id] for marker in once]].reshape(-1, 2))
        bearings = np.concatenate([marker.corners for marker in once])
        pixels = camera.project(_FAR * bearings).pixels
        seen = np.isfinite(pixels).all(-1)
        pose = pose_from_bearings(points, bearings)
        misfit = np.inf if pose is None else _angle_misfit(pose.apply(points), bearings)
        if best is None or misfit < best[0]:
            sigma = np.full(int(seen.sum()), _MARKER_SIGMA_PX)
            best = misfit, _SeenBoard(BoardView(*place, points[seen], pixels[seen], sigma), pattern)
    return None if best is None else best[1]


def _angle_misfit(points: FloatArray, bearings: FloatArray) -> float:
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return float(np.median(np.linalg.norm(rays - bearings, axis=-1)))


def _aligned_view(view: BoardView, aligned: AlignedCorners) -> BoardView:
    sigma = aligned.sigma / aligned.pixel_angle
    return replace(view, points=on_board(aligned.points), pixels=aligned.pixels, sigma=sigma)


def _part(task: IntrinsicsTask, image: Image, lens: int) -> tuple[int, Image]:
    """Return the part of a shot that a lens fills, and its first column."""
    if task.lenses == 1:
        return 0, image
    half = image.shape[1] // 2
    return lens * half, np.ascontiguousarray(image[:, lens * half : (lens + 1) * half])


def _own_part(task: IntrinsicsTask, image: Image, lens: int) -> Image:
    """Return a shot in which what other lenses show is black."""
    if task.lenses == 1:
        return image
    half = image.shape[1] // 2
    own = np.zeros_like(image)
    own[:, lens * half : (lens + 1) * half] = image[:, lens * half : (lens + 1) * half]
    return own


def numbered_boards(views: Sequence[BoardView]) -> list[BoardView]:
    """Return the views of all lenses with boards numbered without gaps: one that is never seen has no number."""
    seen = sorted({view.board for view in views})
    return [replace(view, board=seen.index(view.board)) for view in views]


def _place(task: IntrinsicsTask, shot: str, board: str, lens: int) -> tuple[str, int, int, int]:
    """Return name, shot, board and lens of a view."""
    name = shot + (f" {board}" if len(task.boards) > 1 else "")
    own = list(task.boards).index(board)
    number = task.shots.index(shot)
    if not task.boards_stand_still:
        number, own = number * len(task.boards) + own, 0
    return name + (f" lens {lens}" if task.lenses > 1 else ""), number, own, lens


def _equidistant(task: IntrinsicsTask, lens: int) -> KannalaBrandt:
    """Return a lens that is good enough to find markers through: what is straight stays nearly so over a marker."""
    aperture = task.apertures[lens]
    focal = _FOCAL_GUESS * aperture.width
    reach = float(np.hypot(*task.size)) / 2 / focal
    column, row = (float(value) for value in aperture.center)
    return KannalaBrandt(*task.size, focal, focal, column, row, max_angle=min(reach, _WIDEST))


def _same(first: BoardView, second: BoardView) -> bool:
    if first.shot == second.shot or first.lens != second.lens or first.pixels.shape != second.pixels.shape:
        return False
    return bool(np.abs(first.pixels - second.pixels).max() < _SAME_PX and np.array_equal(first.points, second.points))


def measure_again(
    task: IntrinsicsTask,
    found: Collected,
    cameras: Sequence[CameraModel],
    poses: dict[str, RigidTransform],
    on_progress: Callable[[str], None] = lambda _: None,
) -> tuple[BoardView, ...]:
    """Return the views with the corners of ChArUco boards measured anew, through lenses that are now known better.

    Parameters
    ----------
    task : IntrinsicsTask
        With the shots.
    found : Collected
        What they showed at first.
    cameras : sequence of CameraModel
        Of each lens.
    poses : dict of str to RigidTransform
        ``lens_from_board`` by view; those without one are left out.
    on_progress : callable
        Is told what is done next.
    """
    return tuple(_measured_again(task, found, cameras, poses, on_progress))


def _measured_again(
    task: IntrinsicsTask,
    found: Collected,
    cameras: Sequence[CameraModel],
    poses: dict[str, RigidTransform],
    on_progress: Callable[[str], None],
) -> Iterator[BoardView]:
    shot, image = "", np.empty((0, 0), dtype=np.uint8)
    for view in found.views:
        pattern = found.patterns.get(view.name)
        if pattern is None or view.name not in poses:
            yield view
            continue
        if found.shots[view.name] != shot:
            shot = found.shots[view.name]
            on_progress(f"{shot}: measuring again")
            image = read_image(task.folder / shot, task.size, gray=True)
        aligned = align_corners(cameras[view.lens], image, pattern, poses[view.name])
        yield view if aligned is None else _aligned_view(view, aligned)
