"""The outline of a pallet's front face, and how it looks from the camera on any plane or in the image."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.face import FaceEdge, face_lines
from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL

_ARC_POINTS = 7
"""Points along a rounded corner."""
_JUMP = 0.125
"""Part of the image's height over which neighbours do not lie apart, unless another lens sees the second."""


@lru_cache(maxsize=64)
def face_outline(model: PalletModel, step: float = 0.01) -> tuple[FloatArray, ...]:
    """Return the lines of a front face with its rounded corners.

    Parameters
    ----------
    model : PalletModel
        The pallet.
    step : float
        Largest distance of neighbouring points, in metres: straight lines are curves in a 360-degree image.

    Returns
    -------
    tuple of (n, 2) arrays
        Right and up in metres, from the middle of the lower edge. The outline, which goes around openings at
        the floor, and each other opening; all are closed, and none can be written into.
    """
    half = model.width / 2
    feet = [opening for opening in model.openings if opening.open_below]
    corners = [(-half, 0.0), (-half, model.height), (half, model.height), (half, 0.0)]
    radii = [model.corner_radius] * 4
    for opening in reversed(feet):  # along the floor from right to left, around each opening
        corners += [(opening.right, 0.0), (opening.right, opening.top)]
        corners += [(opening.left, opening.top), (opening.left, 0.0)]
        radii += [0.0, opening.radius, opening.radius, 0.0]
    lines = [_rounded(corners, radii, step)]
    for opening in model.openings:
        if not opening.open_below:
            (left, right), (low, high) = (opening.left, opening.right), (opening.bottom, opening.top)
            box = [(left, low), (left, high), (right, high), (right, low)]
            lines.append(_rounded(box, [opening.radius] * 4, step))
    for line in lines:
        line.flags.writeable = False
    return tuple(lines)


def _rounded(corners: list[tuple[float, float]], radii: list[float], step: float) -> FloatArray:
    """Return a closed polygon with rounded right-angled corners, sampled."""
    points: list[FloatArray] = []
    vertices = np.array(corners)
    for i, (vertex, radius) in enumerate(zip(vertices, radii, strict=True)):
        before, after = vertices[i - 1] - vertex, vertices[(i + 1) % len(vertices)] - vertex
        back, on = before / np.linalg.norm(before), after / np.linalg.norm(after)
        if radius == 0:
            points.append(vertex)
            continue
        center = vertex + radius * (back + on)
        angles = np.linspace(0, np.pi / 2, _ARC_POINTS)[:, None]
        points += list(center - radius * (np.cos(angles) * on + np.sin(angles) * back))
    return sampled(np.array([*points, points[0]]), step)


def sampled(line: FloatArray, step: float) -> FloatArray:
    """Return a polyline, (n, d), with points added so that neighbours are at most a step of its unit apart."""
    pieces = [line[:1]]
    for start, end in pairwise(line):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / step - 1e-9)))
        pieces.append(start + np.linspace(0, 1, count + 1)[1:, None] * (end - start))
    return np.concatenate(pieces)


def stretches_of(model: PalletModel, edge: FaceEdge) -> FloatArray:
    """Return the stretches of a line of the face, (n, 2, 2): ends of each, right and up, in metres."""
    lines = (line for line in face_lines(model) if line.whole == edge)
    stretches = [stretch for line in lines for stretch in line.edges] or [edge]
    return np.array([[stretch.start, stretch.end] for stretch in stretches])


def place_outline(model: PalletModel, pose: LevelPose, step: float = 0.01) -> list[FloatArray]:
    """Return the lines of a front face at a pose.

    Parameters
    ----------
    model : PalletModel
        The pallet.
    pose : LevelPose
        ``target_from_pallet``.
    step : float
        Largest distance of neighbouring points, in metres.

    Returns
    -------
    list of (n, 3) arrays
        In the target frame.
    """
    target_from_face = pose.transform() * PALLET_FROM_VERTICAL
    return [
        target_from_face.apply(np.column_stack([line, np.zeros(len(line))])) for line in face_outline(model, step)
    ]


def seen_on_plane(points: FloatArray, plane_from_camera: FloatArray) -> FloatArray:
    """Return where a plane shows points that do not lie on it.

    Parameters
    ----------
    points : (..., 3) array
        In the plane's coordinates: right, up, towards the viewer.
    plane_from_camera : (3,) array
        The camera's centre in the same coordinates.

    Returns
    -------
    (..., 2) array
        Right and up where the ray to each point meets the plane; NaN where it does not.
    """
    away = plane_from_camera[2] - points[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = plane_from_camera[2] / away
        met = plane_from_camera[:2] + share * (points[..., :2] - plane_from_camera[:2])
    return np.where(share > 0, met, np.nan)


def project_line(camera: CameraModel, camera_from_target: RigidTransform, line: FloatArray) -> list[FloatArray]:
    """Return the curve of a line in the image, in pieces without a jump.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    camera_from_target : RigidTransform
        Of the frame that the line is given in.
    line : (n, 3) array
        Its points, close to each other.

    Returns
    -------
    list of (m, 2) arrays
        Columns and rows. Where the image closes around, a piece that leaves it at one side is there twice,
        once for each side.
    """
    pixels, valid = camera.project(camera_from_target.apply(line))
    if camera.period_px is None:
        return _pieces(pixels, valid, camera.height * _JUMP)
    pixels = pixels.copy()
    pixels[valid, 0] = np.unwrap(pixels[valid, 0], period=camera.period_px)
    return [
        piece - np.array([turn * camera.period_px, 0.0])
        for piece in _pieces(pixels, valid, camera.height * _JUMP)
        for turn in _turns(piece, camera.period_px)
    ]


def _turns(piece: FloatArray, period: float) -> FloatArray:
    """Return how many times around the image the two ends of an unwrapped piece lie, and all between."""
    low, high = np.floor((np.array([piece[:, 0].min(), piece[:, 0].max()]) + 0.5) / period)
    return np.arange(low, high + 1)


def _pieces(pixels: FloatArray, valid: BoolArray, jump: float) -> list[FloatArray]:
    """Return the runs of at least two neighbours that are seen and not farther apart than a jump."""
    with np.errstate(invalid="ignore"):
        joined = valid[1:] & valid[:-1] & (np.hypot(*np.diff(pixels, axis=0).T) < jump)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], joined, [False]]).astype(int)))
    return [pixels[first : last + 1] for first, last in ends.reshape(-1, 2)]
