"""From shots to corners of boards, lens by lens; shots that are there twice count once."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearings import pose_from_bearings
from calibration.intrinsics.chessboards import SIGMA_PX, find_chessboard
from calibration.intrinsics.corner_file import read_corners
from calibration.intrinsics.task import Chessboard, IntrinsicsTask
from calibration.lenses.bundle import BoardView
from calibration.targets.board_detection import SCALES, Marker, detect_markers
from calibration.targets.targets import CharucoBoard, PrintedPattern, on_board, patterns
from calibration.targets.texture_alignment import AlignedCorners, align_corners
from palletloc.cameras import CameraModel, KannalaBrandt
from palletloc.geometry import FloatArray, Image
from palletloc.io.images import read_image
from palletloc.io.reading import read_bytes

_SAME_PX = 1e-3
_FOCAL_GUESS, _FAR = 0.4, 100.0
_MARKER_SIGMA_PX, _FEWEST_MARKERS = 0.3, 3
_WIDEST = float(np.radians(115.0))


@dataclass(slots=True, eq=False)
class Collected:
    """What the shots show."""

    views: list[BoardView] = field(default_factory=list)
    """Each board in each shot through each lens."""
    duplicates: list[tuple[str, str]] = field(default_factory=list)
    """Views that are the same as an earlier one, with that one."""
    empty: list[str] = field(default_factory=list)
    """Shots without a board."""
    patterns: dict[str, PrintedPattern] = field(default_factory=dict)
    """Of the ChArUco boards, by view."""
    shots: dict[str, str] = field(default_factory=dict)
    """The shot of each view."""


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
    found = Collected()
    if task.corners is not None:
        found.views = read_corners(task.corners, task.size, task.lenses, fixed=task.boards_stand_still)
    else:
        _collect_shots(task, found, on_progress)
    _merge_same_corners(found)
    found.views = numbered_boards(found.views)
    return found


def _collect_shots(task: IntrinsicsTask, found: Collected, on_progress: Callable[[str], None]) -> None:
    seen: dict[str, str] = {}
    for shot in task.shots:
        path = task.folder / shot
        digest = hashlib.sha256(read_bytes(path)).hexdigest()
        if digest in seen:
            found.duplicates.append((shot, seen[digest]))
            continue
        seen[digest] = shot
        on_progress(f"{shot}: looking for boards")
        image = read_image(path, task.size, gray=True)
        before = len(found.views)
        for lens in range(task.lenses):
            _collect_lens(task, found, image, shot, lens)
        if len(found.views) == before:
            found.empty.append(shot)


def _collect_lens(task: IntrinsicsTask, found: Collected, image: Image, shot: str, lens: int) -> None:
    plain = {name: board for name, board in task.boards.items() if isinstance(board, Chessboard)}
    for name, chessboard in plain.items():
        offset, part = _part(task, image, lens)
        corners = find_chessboard(part, chessboard)
        if corners is not None:
            sigma = np.full(len(corners), SIGMA_PX)
            place = _place(task, shot, name, lens)
            found.views.append(BoardView(*place, chessboard.corners, corners + np.array([offset, 0.0]), sigma))
            found.shots[place[0]] = shot
    coded = {name: board for name, board in task.boards.items() if isinstance(board, CharucoBoard)}
    if coded:
        _collect_coded(task, found, image, shot, lens, coded)


def _collect_coded(
    task: IntrinsicsTask, found: Collected, image: Image, shot: str, lens: int, boards: dict[str, CharucoBoard]
) -> None:
    """Add the corners of markers, which need no lens that is known well; they are measured again when it is."""
    camera = task.start_of_lens(lens) or _equidistant(task, lens)
    own = _own_part(task, image, lens)
    for dictionary in sorted({board.dictionary for board in boards.values()}):
        mine = {name: board for name, board in boards.items() if board.dictionary == dictionary}
        missing = dict(mine)
        for scale in SCALES:
            markers = detect_markers(camera, own, dictionary, scale) if missing else []
            for name, board in list(missing.items()):
                place = _place(task, shot, name, lens)
                best = _marker_view(camera, markers, board, place)
                if best is not None:
                    del missing[name]
                    found.views.append(best[0])
                    found.patterns[place[0]], found.shots[place[0]] = best[1], shot


def _marker_view(
    camera: CameraModel, markers: Sequence[Marker], board: CharucoBoard, place: tuple[str, int, int, int]
) -> tuple[BoardView, PrintedPattern] | None:
    """Return the corners of a board's markers, and which of its layouts fits them; None where too few are seen."""
    counts = Counter(marker.id for marker in markers)
    best: tuple[float, BoardView, PrintedPattern] | None = None
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
            best = misfit, BoardView(*place, points[seen], pixels[seen], sigma), pattern
    return best[1:] if best is not None else None


def _angle_misfit(points: FloatArray, bearings: FloatArray) -> float:
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    return float(np.median(np.linalg.norm(rays - bearings, axis=-1)))


def _corners(aligned: AlignedCorners) -> tuple[FloatArray, FloatArray, FloatArray]:
    return on_board(aligned.points), aligned.pixels, aligned.sigma / aligned.pixel_angle


def _aligned_view(view: BoardView, aligned: AlignedCorners) -> BoardView:
    points, pixels, sigma = _corners(aligned)
    return replace(view, points=points, pixels=pixels, sigma=sigma)


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
    """Return views with their boards numbered without gaps, so that a board that is never seen has no number.

    Parameters
    ----------
    views : sequence of BoardView
        Of all lenses.
    """
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
    column, row = (float(one) for one in aperture.center)
    return KannalaBrandt(*task.size, focal, focal, column, row, max_angle=min(reach, _WIDEST))


def _merge_same_corners(found: Collected) -> None:
    """Drop views whose corners another view has, too."""
    kept: list[BoardView] = []
    for view in found.views:
        twin = next((one for one in kept if _same(one, view)), None)
        if twin is None:
            kept.append(view)
        else:
            found.duplicates.append((view.name, twin.name))
    found.views = kept


def _same(one: BoardView, other: BoardView) -> bool:
    if one.shot == other.shot or one.lens != other.lens or one.pixels.shape != other.pixels.shape:
        return False
    return bool(np.abs(one.pixels - other.pixels).max() < _SAME_PX and np.array_equal(one.points, other.points))


def measure_again(
    task: IntrinsicsTask,
    found: Collected,
    cameras: Sequence[CameraModel],
    poses: dict[str, RigidTransform],
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[BoardView]:
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
    return list(_measured_again(task, found, cameras, poses, on_progress))


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
