"""A plane moved through its neighbourhood: at which distances shots from several places see the same on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.drive import compose, evenly_spread, relative
from calibration.shelf.plane import Foot, PlaneEstimate
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.io.recording import Recording
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, place_plane
from palletloc.projection import Projector

SWEEP = "sweep"
"""Name of the method."""
REACH = 0.15
"""How far before and behind the known plane is looked, in metres: the wall behind a shelf is farther."""
SIGMA = 0.05
"""How far the surface with most texture may be from the wanted plane where nothing tells, in metres."""
_LEAST_APART = 0.02
"""How far surfaces stand apart at least where other methods tell, in metres."""
_STEP = 0.01
"""Between the distances that are tried, in metres: a parabola finds the peak between them."""
_RESOLUTION, _WINDOW = 0.005, 15
"""Of the views, in metres, and the side of a window in pixels: 7.5 cm, less than an upright is wide."""
_ASIDE, _HEIGHTS = 1.0, (0.1, 2.3)
"""Half the width of the views and their heights, in metres: what shots from both sides see well."""
_WANTED, _LEAST, _MOST = 0.3, 0.12, 0.6
"""Baseline of shots that are compared, in parts of the distance: best, least and most. Short ones do not tell
the distance, on long ones things look different."""
_MOST_GROUPS = 8
"""Groups of shots that are compared: more take time and show the same."""
_ALIKE = 0.9
"""Windows correlate more where they show the same surface."""
_TEXTURE, _ACROSS = 0.03, 0.5
"""Least contrast of a window, in parts of the light, and least part of its variance along the shelf."""
_LEAST_WINDOWS = 200
"""Fewer windows tell nothing: a share of 3 % of 200 scatters by 1.2 %."""
_LEAST_SCORE, _ABOVE_FLOOR, _SECOND = 0.03, 2.0, 0.7
"""A clear peak is higher than the first, than so many times the lower quartile, and has no second above that part
of it."""

_FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Peak:
    """A distance at which more windows agree than at those beside it."""

    distance: float
    """From the foot's point, in metres."""
    score: float
    """Part of the windows that agree, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneSweep:
    """What moving the plane gave."""

    distances: FloatArray
    """(n,) that were tried, in metres from the foot's point, evenly spaced."""
    scores: FloatArray
    """(n,) part of the windows that look alike in all shots of their group, smoothed over three distances."""
    windows: int
    """How many windows with texture there are, on average over the distances."""
    peaks: tuple[Peak, ...]
    """All of them, the highest first."""
    refusal: str | None
    """Why the highest is not the answer: ``sweep_flat``, ``sweep_at_edge`` or ``sweep_ambiguous``; None if it is."""

    @property
    def distance(self) -> float | None:
        """Distance of the surface with most texture, in metres; None where no peak is clear."""
        return None if self.refusal else self.peaks[0].distance


def sweep_plane(
    recording: Recording, shots: Sequence[int], poses: FloatArray, foot: Foot, turn: float, distance: float
) -> PlaneSweep:
    """Move a plane by 15 cm towards the camera and away from it, and count what shots agree on.

    Parameters
    ----------
    recording, shots, poses
        As for `beam_lines`.
    foot : Foot
        What planes are described from.
    turn, distance : float
        The plane as known, in radians and metres; the heading is kept.

    Returns
    -------
    PlaneSweep
        Without windows where no two shots have a baseline.

    Notes
    -----
    Windows of 7.5 cm whose brightness changes along the shelf are compared between a shot and its neighbours on
    the way, by normalized cross-correlation. A window agrees where the least of these is above 0.9. Greater windows
    would span the front and what stands behind it, and prefer that.
    """
    projector = Projector(recording.camera, cache_bytes=0)
    distances: FloatArray = distance + _STEP * np.arange(
        -round(REACH / _STEP), round(REACH / _STEP) + 1, dtype=np.float64
    )
    alike, windows = np.zeros(len(distances)), np.zeros(len(distances))
    for group in _groups(recording, poses, foot, turn, distance):
        images = [recording.image(recording.shots[shots[i]], gray=True) for i in group]
        along = _along(recording, poses[group[0]], foot, turn)
        for k, deep in enumerate(distances):
            views = list(_views(recording, projector, images, poses[list(group)], (foot, turn, float(deep), along)))
            agreeing, textured = _agreement(views)
            alike[k] += agreeing
            windows[k] += textured
    return judged(distances, alike / np.maximum(windows, 1), round(float(windows.mean())))


def judged(distances: FloatArray, scores: FloatArray, windows: int) -> PlaneSweep:
    """Find the peaks of a sweep, and say whether the highest one is clear.

    Parameters
    ----------
    distances : (n,) array
        Evenly spaced, in metres.
    scores : (n,) array
        Part of the windows that agree there.
    windows : int
        How many there are.
    """
    padded = np.pad(scores, 1, mode="edge")
    smooth = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4
    inner = np.flatnonzero((smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])) + 1
    peaks = sorted((_peak(distances, smooth, int(i)) for i in inner), key=lambda peak: -peak.score)
    return PlaneSweep(distances, smooth, windows, tuple(peaks), _refusal(smooth, windows, peaks))


def sweep_estimate(sweep: PlaneSweep, turn: float, estimates: Sequence[PlaneEstimate]) -> PlaneEstimate | None:
    """Return what a sweep says of the plane's distance; its heading was given.

    The peak may belong to uprights, beams or pallets. How far these stand apart here the other methods tell; that,
    and the peak's width, make its standard deviation.

    Parameters
    ----------
    sweep : PlaneSweep
        With its peaks.
    turn : float
        The heading that it was made with, against the foot's, in radians.
    estimates : sequence of PlaneEstimate
        Of the other methods.

    Returns
    -------
    PlaneEstimate or None
        None where no peak is clear.
    """
    if sweep.distance is None:
        return None
    planes = [
        estimate.distance
        for estimate in estimates
        if np.isfinite(estimate.distance) and estimate.information[1, 1] > 0
    ]
    apart = max(float(np.ptp(planes)), _LEAST_APART) if len(planes) > 1 else SIGMA
    sigma = float(np.hypot(apart, _width(sweep)))
    evidence = f"{100 * sweep.peaks[0].score:.0f} % of {sweep.windows} windows alike"
    return PlaneEstimate(SWEEP, turn, sweep.distance, np.diag([0.0, sigma**-2]), evidence)


def _width(sweep: PlaneSweep) -> float:
    """Return the width of the highest peak, over the scores' lower quartile, as a standard deviation, in metres."""
    floor = float(np.percentile(sweep.scores, 25))
    rise = np.maximum(sweep.scores - floor, 0.0)
    top = int(rise.argmax())
    half = rise >= rise[top] / 2
    low, high = top, top
    while low > 0 and half[low - 1]:
        low -= 1
    while high < len(half) - 1 and half[high + 1]:
        high += 1
    return float(sweep.distances[high] - sweep.distances[low] + sweep.distances[1] - sweep.distances[0]) / 2.355


def _refusal(scores: FloatArray, windows: int, peaks: Sequence[Peak]) -> str | None:
    top = int(scores.argmax())
    if windows < _LEAST_WINDOWS or scores[top] < max(_LEAST_SCORE, _ABOVE_FLOOR * float(np.percentile(scores, 25))):
        return "sweep_flat"
    if not 2 <= top < len(scores) - 2:
        return "sweep_at_edge"
    second = max([peak.score for peak in peaks[1:]] + [float(scores[0]), float(scores[-1])])
    return "sweep_ambiguous" if second >= _SECOND * peaks[0].score else None


def _peak(distances: FloatArray, scores: FloatArray, i: int) -> Peak:
    """Return the top of the parabola through a maximum and its neighbours."""
    left, top, right = scores[i - 1 : i + 2]
    bend = left - 2 * top + right
    off = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return Peak(float(distances[i] + off * (distances[1] - distances[0])), float(top))


def _along(recording: Recording, pose: FloatArray, foot: Foot, turn: float) -> float:
    """Return the camera's place along the plane, in metres to the right."""
    camera = compose(pose, np.array([*recording.mounting.center[:2], 0.0]))[:2]
    return float(Foot(foot.point, foot.yaw + turn).local(camera[None])[0, 0])


def _groups(
    recording: Recording, poses: FloatArray, foot: Foot, turn: float, distance: float
) -> list[tuple[int, ...]]:
    """Return shots, each with the neighbour on either side that has the best baseline, where one has."""
    along = np.array([_along(recording, pose, foot, turn) for pose in poses]) / distance
    groups = []
    for i, place in enumerate(along):
        group = [i]
        for side in (-1, 1):
            baseline = side * (along - place)
            best = int(np.abs(baseline - _WANTED).argmin())
            if _LEAST <= baseline[best] <= _MOST:
                group.append(best)
        if len(group) > 1:
            groups.append(tuple(group))
    whole = [group for group in groups if len(group) == 3] or groups
    return [whole[i] for i in evenly_spread(len(whole), _MOST_GROUPS)]


def _views(
    recording: Recording,
    projector: Projector,
    images: Sequence[Image],
    poses: FloatArray,
    plane: tuple[Foot, float, float, float],
) -> Iterator[tuple[_FloatImage, NDArray[np.bool_]]]:
    """Yield what each shot shows of a part of the plane, and where it shows any."""
    foot, turn, distance, along = plane
    yaw = foot.yaw + turn
    into = np.array([np.cos(yaw), np.sin(yaw)])
    x, y = foot.point + distance * into + along * np.array([into[1], -into[0]])
    grid = PlaneGrid.spanning(-_ASIDE, _ASIDE, *_HEIGHTS, _RESOLUTION)
    camera_from_forklift = recording.forklift_from_camera.inv()
    for image, pose in zip(images, poses, strict=True):
        beside_x, beside_y, towards = (float(v) for v in relative(pose, np.array([x, y, yaw])))
        beside = LevelPose(beside_x, beside_y, 0.0, towards)
        view = projector.view(image, place_plane(camera_from_forklift, beside, PALLET_FROM_VERTICAL), grid)
        yield view.image.astype(np.float32), view.valid


def _agreement(views: Sequence[tuple[_FloatImage, NDArray[np.bool_]]]) -> tuple[int, int]:
    """Return how many windows agree, and how many have texture."""
    image, valid = views[0]
    mean, spread = _moments(image)
    rows = cv2.blur(image, (_WINDOW, 1))
    # What changes only with the height looks the same from all places of the way.
    upward = _box(rows * rows) - mean * mean
    bright = float(np.median(image[valid])) if valid.any() else 0.0
    textured = (spread > (_TEXTURE * max(bright, 30.0)) ** 2) & (spread - upward > _ACROSS * spread)
    least = np.full(image.shape, 1.0, np.float32)
    for other, seen in views[1:]:
        valid = valid & seen
        its_mean, its_spread = _moments(other)
        both = _box(image * other) - mean * its_mean
        least = np.minimum(least, both / np.sqrt(np.maximum(spread * its_spread, 1e-6)))
    whole = cv2.erode(valid.astype(np.uint8), np.ones((_WINDOW, _WINDOW), np.uint8), borderValue=0) > 0
    apart = slice(_WINDOW // 2, None, _WINDOW // 2)
    used = (textured & whole)[apart, apart]
    return int((used & (least[apart, apart] > _ALIKE)).sum()), int(used.sum())


def _moments(image: _FloatImage) -> tuple[_FloatImage, _FloatImage]:
    """Return mean and variance of the windows around each pixel."""
    mean = _box(image)
    return mean, np.maximum(_box(image * image) - mean * mean, 0)


def _box(image: _FloatImage) -> _FloatImage:
    return np.asarray(cv2.blur(image, (_WINDOW, _WINDOW)), dtype=np.float32)
