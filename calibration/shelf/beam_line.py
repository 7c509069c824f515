"""Beams whose height is known: each shot alone cuts the rays to their front edge with the level."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.drive import relative
from calibration.shelf.plane import Foot, PlaneEstimate
from calibration.targets.patches import sample
from palletloc.geometry import FloatArray, Image
from palletloc.io.recording import Recording
from palletloc.robust import cauchy_weights, reweighted, robust_sigma

BEAMS = "beams"
"""Name of the method."""
_LEAST_LEVER = 0.15
"""A level nearer to the height of the camera tells nothing, in metres: 6 mm of it move the edge by 4 % of the
distance."""
_LEAST_LEVEL = 0.2
"""A lower level is the floor, in metres."""
_ON_LEVEL = 0.3
"""A pallet that stands no farther above or below a beam, in metres, hides it."""
_WIDE, _STEP, _FINE = 2.2, 0.02, 0.002
"""Half the width of a shot's view, its step along the front, and its step in depth, in metres."""
_TURNS = np.radians(np.arange(-1.5, 1.51, 0.05))
"""Turns of the edge that are tried, in radians: what other methods leave open."""
_BLOCK = 10
"""Steps along the front that make one point: 0.2 m average over rivets and labels."""
_LEAST_POINTS, _LEAST_LENGTH = 12, 0.8
"""Points of an edge at least, and their extent in metres: fewer may be a pallet."""
_LEVEL_ERROR = 0.006
"""How far the edge that is seen may lie below the level, in metres: beams are rounded."""
_BUILT_DEPTH, _BUILT_TURN = 0.02, float(np.radians(0.5))
"""How far beams stand off the front, in metres and radians, as shelves are built."""
_SHARED = 4.0
"""Shots share what is wrong with the beam and the light on it: a quarter of them count."""
_ROUNDS, _LEAST_SCATTER = 12, 0.0005
"""Of the robust line: rounds, more than the weights need to settle, and least scatter in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamSearch:
    """Where the front edges of beams are looked for."""

    foot: Foot
    """What planes are described from."""
    turn: float
    """The front's heading against the foot's, in radians."""
    distance: float
    """The front's distance from the foot's point, in metres."""
    reach: float
    """How far before and behind it a beam is looked for, in metres."""
    taken: FloatArray
    """(m, 3) what stands before the beams, as pallets do: from and to along the front, and its height, in metres."""


def beam_lines(
    recording: Recording,
    shots: Sequence[int],
    poses: FloatArray,
    search: BeamSearch,
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[PlaneEstimate]:
    """Measure the front edge of each beam whose height is known.

    Parameters
    ----------
    recording : Recording
        With the levels.
    shots : sequence of int
        Which of its shots to use.
    poses : (n, 3) array
        ``odom_from_forklift`` at these.
    search : BeamSearch
        Where to look.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    list of PlaneEstimate
        One for each level that shows a beam and is not near the camera's height.
    """
    camera_height = float(recording.mounting.center[2])
    levels = [
        level
        for level in recording.shelf.levels
        if level > _LEAST_LEVEL and abs(level - camera_height) >= _LEAST_LEVER
    ]
    found = []
    for level in levels:
        on_progress(f"looking for the beam at {level:.2f} m")
        points = _edge_points(recording, shots, poses, search, level)
        estimate = _fitted(points, search, level - camera_height, recording.mounting.sigma, level)
        if estimate is not None:
            found.append(estimate)
    return found


def _edge_points(
    recording: Recording, shots: Sequence[int], poses: FloatArray, search: BeamSearch, level: float
) -> FloatArray:
    """Return places of the edge, (n, 3): along the front, depth behind it, and the shot."""
    maps = []
    for index, pose in zip(shots, poses, strict=True):
        image = recording.image(recording.shots[index], gray=True)
        maps.append(_slopes(recording, image, pose, search, level))
    along = np.arange(-2 * _WIDE, 2 * _WIDE, _STEP)
    total = np.zeros((len(along), maps[0][1].shape[1]))
    for first, slopes in maps:
        start = round((first - along[0]) / _STEP)
        low, high = max(start, 0), min(start + len(slopes), len(along))
        total[low:high] += slopes[low - start : high - start]
    line = _straightest(along, total)
    if line is None:
        return np.zeros((0, 3))
    turn, depth, sign = line
    points = []
    for shot, (first, slopes) in enumerate(maps):
        places: FloatArray = first + _STEP * np.arange(len(slopes), dtype=np.float64)
        points += [(a, d, shot) for a, d in _followed(places, sign * slopes, depth, turn)]
    return np.array(points).reshape(-1, 3)


def _slopes(
    recording: Recording, image: Image, pose: FloatArray, search: BeamSearch, level: float
) -> tuple[float, FloatArray]:
    """Return the first place along the front, and the derivative of brightness by depth on the level's plane."""
    yaw = search.foot.yaw + search.turn
    into = np.array([np.cos(yaw), np.sin(yaw)])
    right = np.array([into[1], -into[0]])
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    center = recording.mounting.center
    camera = pose[:2] + np.array([cos * center[0] - sin * center[1], sin * center[0] + cos * center[1]])
    middle = float(np.clip((camera - search.foot.point) @ right, -_WIDE, _WIDE))
    first = _STEP * round((middle - _WIDE) / _STEP)
    along = first + np.arange(0, 2 * _WIDE, _STEP)
    deep = np.arange(-search.reach, search.reach + _FINE / 2, _FINE)
    places = search.foot.point + along[:, None, None] * right + (search.distance + deep)[None, :, None] * into
    at = relative(pose, np.concatenate([places, np.zeros((*places.shape[:2], 1))], axis=-1))
    at[..., 2] = level
    inverse = recording.mounting.camera_from_forklift
    pixels, valid = recording.camera.project(at @ inverse[:3, :3].T + inverse[:3, 3])
    seen = sample(recording.camera, image, pixels).astype(np.float32)
    light = max(float(np.median(seen[valid])) if valid.any() else 0.0, 1.0)
    smooth = cv2.GaussianBlur(seen, (0, 0), sigmaX=0.006 / _FINE, sigmaY=1.0)
    slopes = np.gradient(smooth, axis=1) / light
    slopes[~valid] = 0.0
    for low, high, height in search.taken:
        if abs(height - level) < _ON_LEVEL:
            slopes[(along > low) & (along < high)] = 0.0
    return first, slopes.astype(np.float64)


def _straightest(along: FloatArray, total: FloatArray) -> tuple[float, float, float] | None:
    """Return turn, depth and sign of the straight line across which most of the brightness changes."""
    count = total.shape[1]
    deep = (np.arange(count) - count // 2) * _FINE
    used = np.abs(total).max(axis=1) > 0
    if used.sum() * _STEP < _LEAST_LENGTH:
        return None
    clipped = np.clip(total[used], *np.array([-1, 1]) * np.percentile(np.abs(total[used]), 90))
    best: tuple[float, float, float, float] | None = None
    for turn in _TURNS:
        shift = np.rint(np.tan(turn) * along[used] / _FINE).astype(int)
        rows = np.stack([np.roll(row, -s) for row, s in zip(clipped, shift, strict=True)])
        mean = rows.mean(axis=0)
        edge = int(np.abs(mean[5:-5]).argmax()) + 5
        if best is None or abs(mean[edge]) > best[0]:
            best = (abs(float(mean[edge])), float(turn), float(deep[edge]), float(np.sign(mean[edge])))
    if best is None or abs(best[2]) > deep[-1] - 0.012:
        return None
    return best[1:]


def _followed(places: FloatArray, slopes: FloatArray, depth: float, turn: float) -> list[tuple[float, float]]:
    """Return where the edge is in each block of places."""
    count = slopes.shape[1]
    found = []
    for start in range(0, len(places) - _BLOCK + 1, _BLOCK):
        block = slopes[start : start + _BLOCK]
        place = float(places[start : start + _BLOCK].mean())
        middle = round((depth + np.tan(turn) * place) / _FINE) + count // 2
        low, high = middle - 9, middle + 10
        if low < 0 or high > count:
            continue
        if not np.abs(block).max(axis=1).all():
            continue
        profile = block[:, low:high].mean(axis=0)
        best = int(profile.argmax())
        if not 0 < best < len(profile) - 1 or profile[best] < 0.002:
            continue
        left, top, right = profile[best - 1 : best + 2]
        bend = left - 2 * top + right
        off = 0.5 * (left - right) / bend if bend < 0 else 0.0
        found.append((place, (low + best + off - count // 2) * _FINE))
    return found


def _fitted(
    points: FloatArray, search: BeamSearch, lever: float, mounting: FloatArray, level: float
) -> PlaneEstimate | None:
    """Return the line through the places of an edge, robustly; None where they are too few."""
    if len(points) < _LEAST_POINTS or np.ptp(points[:, 0]) < _LEAST_LENGTH:
        return None
    along, depth, shot = points.T
    design = np.stack([np.ones(len(along)), along], axis=1)

    def fit(weights: FloatArray, _: float) -> FloatArray:
        root = np.sqrt(weights)
        return np.asarray(np.linalg.lstsq(design * root[:, None], depth * root, rcond=None)[0])

    found = reweighted(
        fit,
        lambda line: depth - design @ line,
        cauchy_weights,
        lambda off: robust_sigma(off, _LEAST_SCATTER),
        np.ones(len(along)),
        _ROUNDS,
    )
    # Shots share what is wrong with the beam and with the light on it: a quarter of them count.
    normal = (design * np.sqrt(found.weights)[:, None] ** 2).T @ design
    covariance = np.linalg.inv(normal) * found.sigma**2 * _SHARED
    reach = abs(search.distance / lever)
    bent = (search.distance**2 + lever**2) / abs(lever)
    height = np.hypot(_LEVEL_ERROR, mounting[2]) * reach
    tilt = float(np.max(mounting[3:5]))
    covariance += np.diag([height**2 + (bent * tilt) ** 2 + _BUILT_DEPTH**2, (reach * tilt) ** 2 + _BUILT_TURN**2])
    covariance = covariance[::-1, ::-1]
    evidence = f"front edge at {level:.2f} m over {np.ptp(along):.1f} m in {len(np.unique(shot))} shots"
    turn = search.turn + float(np.arctan(found.solution[1]))
    distance = float(search.distance + found.solution[0]) * float(np.cos(np.arctan(found.solution[1])))
    return PlaneEstimate(f"{BEAMS} {level:.2f} m", turn, distance, np.asarray(np.linalg.inv(covariance)), evidence)
