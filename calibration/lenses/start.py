"""A first lens and first poses, from nothing but corners: equidistant lenses are tried, one after another.

With a focal length, pixels are bearings, and each board has a pose by linear equations. The best focal length
gives the start of a Kannala-Brandt fit, which then starts any other model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearings import pose_from_bearings
from calibration.lenses.models import MODELS, LensModel
from calibration.lenses.problem import BoardView, LensProblem, Rig, adjust
from palletloc.geometry import BoolArray, FloatArray

_FISHEYE = MODELS["kannala_brandt"]
"""The model of the first fit: it is near to any lens, and all its shapes are reached from zero."""
_PERSPECTIVE_LIMIT = np.radians(75.0)
"""Corners farther off axis, in radians, start no pinhole: errors of their pixels grow without bound."""
_MOST_VIEWS, _FEWEST = 12, 3
"""Views that choose the focal length, which is only a start: more take time. And the fewest for a fit."""
_FACTORS = np.geomspace(0.12, 3.0, 24)
"""Focal lengths that are tried, in widths of the image: a half sphere on 0.4 of them, to 20 degrees."""
_IDENTITY = RigidTransform.identity(1)
"""Place of the only lens, and of the only board."""


def _equidistant_bearings(pixels: FloatArray, focal: float, center: FloatArray) -> FloatArray:
    """Return the unit vectors that pixels look along through an equidistant lens, (n, 3)."""
    across = (pixels - center) / focal
    angle = np.linalg.norm(across, axis=-1)
    scale = np.sinc(angle / np.pi)
    return np.stack([np.cos(angle), -scale * across[:, 0], -scale * across[:, 1]], axis=-1)


def first_fisheye(
    views: Sequence[BoardView], center: FloatArray, width: float
) -> tuple[FloatArray, list[RigidTransform | None]]:
    """Return parameters of a Kannala-Brandt lens and the pose of each board, None where it has none.

    Parameters
    ----------
    views : sequence of BoardView
        Of one lens, each with a board of its own pose.
    center : (2,) array
        Near the pixel of its axis.
    width : float
        Of what it shows, in pixels.
    """
    chosen = views[:: max(1, len(views) // _MOST_VIEWS)]
    focals = width * _FACTORS
    misfits = [_misfit(chosen, focal, center) for focal in focals]
    focal = float(focals[int(np.argmin(misfits))])
    values = _FISHEYE.start_values(focal, center)[0]
    poses = [_pose(view, values) for view in views]
    values = _adjusted(views, poses, values)
    # With a better lens, boards may get a pose that had none, or a better one.
    return values, _posed(views, poses, values)


def _misfit(views: Sequence[BoardView], focal: float, center: FloatArray) -> float:
    """Return the typical misfit in pixels of boards through an equidistant lens."""
    values = _FISHEYE.start_values(focal, center)[0]
    misfits = [_pose_misfit(view, _pose(view, values), values) for view in views]
    return float(np.median(misfits)) if misfits else np.inf


def _pose(view: BoardView, values: FloatArray) -> RigidTransform | None:
    return pose_from_bearings(view.points, _equidistant_bearings(view.pixels, float(values[0]), values[2:4]))


def _pose_misfit(view: BoardView, pose: RigidTransform | None, values: FloatArray) -> float:
    if pose is None:
        return 1e6
    pixels = _FISHEYE.evaluate(values, pose.apply(view.points)).pixels
    return float(np.nan_to_num(np.median(np.linalg.norm(pixels - view.pixels, axis=-1)), nan=1e6))


def _adjusted(views: Sequence[BoardView], poses: Sequence[RigidTransform | None], values: FloatArray) -> FloatArray:
    """Return the lens after a robust fit: focal lengths and centre first, then all."""
    seen = [(view, pose) for view, pose in zip(views, poses, strict=True) if pose is not None]
    if len(seen) < _FEWEST:
        return values
    own = tuple(replace(view, shot=i, board=0, lens=0) for i, (view, _) in enumerate(seen))
    problem = LensProblem(own, (_FISHEYE,))
    rig = Rig((values,), _IDENTITY, RigidTransform.concatenate([pose for _, pose in seen]), _IDENTITY)
    for free in ("fx fy", "fx fy cx cy k1", "fx fy cx cy k1 k2 k3 k4"):
        chosen = np.array([name in free.split() for name in _FISHEYE.parameters])
        rig = adjust(problem, rig, chosen, robust=_spread(problem, rig))
    return rig.values[0]


def _spread(problem: LensProblem, rig: Rig) -> float:
    """Return twice the typical size of a residual, in sigmas."""
    return 2 * float(np.nanmedian(np.linalg.norm(problem.linearize(rig).residuals, axis=-1))) + 1e-3


def _posed(
    views: Sequence[BoardView], poses: Sequence[RigidTransform | None], values: FloatArray
) -> list[RigidTransform | None]:
    """Return each board's pose through a lens that is known well: from the one given or from the equations anew."""
    candidates = [
        [candidate for candidate in (pose, _pose_through(view, values)) if candidate is not None]
        for view, pose in zip(views, poses, strict=True)
    ]
    seen = [
        (i, replace(views[i], board=0, lens=0), _best(views[i], found, values))
        for i, found in enumerate(candidates)
        if found
    ]
    refined: list[RigidTransform | None] = [None] * len(views)
    if seen:
        problem = LensProblem(tuple(replace(view, shot=k) for k, (_, view, _) in enumerate(seen)), (_FISHEYE,))
        rig = Rig((values,), _IDENTITY, RigidTransform.concatenate([pose for *_, pose in seen]), _IDENTITY)
        shots = adjust(problem, rig, np.zeros(len(values), dtype=np.bool_), robust=_spread(problem, rig)).shots
        for k, (i, _, _) in enumerate(seen):
            refined[i] = shots[k]
    return refined


def _best(view: BoardView, poses: Sequence[RigidTransform], values: FloatArray) -> RigidTransform:
    return min(poses, key=lambda pose: _pose_misfit(view, pose, values))


def _pose_through(view: BoardView, values: FloatArray) -> RigidTransform | None:
    """Return the pose by the linear equations, with the bearings of the fitted lens."""
    across = (view.pixels - values[2:4]) / values[:2]
    radius = np.linalg.norm(across, axis=-1)
    angles = np.linspace(0.0, np.pi, 721)
    radii = angles + (angles[:, None] ** np.array([3, 5, 7, 9])) @ values[4:]
    rising = int(np.argmax(np.append(np.diff(radii) <= 0, True)))
    angle = np.interp(radius, radii[: rising + 1], angles[: rising + 1])
    scale = np.sin(angle) / np.maximum(radius, 1e-12)
    return pose_from_bearings(
        view.points, np.stack([np.cos(angle), -scale * across[:, 0], -scale * across[:, 1]], axis=-1)
    )


def start_model(
    model: LensModel, fisheye: FloatArray, views: Sequence[BoardView], poses: Sequence[RigidTransform]
) -> tuple[list[FloatArray], list[BoolArray]]:
    """Return parameters of a model that images the boards as a Kannala-Brandt lens does, and the corners it images.

    Where the model has more than one shape that nearly does, each is given.

    Parameters
    ----------
    model : LensModel
        To be started.
    fisheye : (8,) array
        Parameters of the Kannala-Brandt lens.
    views : sequence of BoardView
        Of this lens.
    poses : sequence of RigidTransform
        ``lens_from_board`` of each.
    """
    rays = [pose.apply(view.points) for view, pose in zip(views, poses, strict=True)]
    limit = _PERSPECTIVE_LIMIT if model.perspective else np.pi
    near = [directions[:, 0] > np.cos(limit) * np.linalg.norm(directions, axis=-1) for directions in rays]
    if model is _FISHEYE:
        return [fisheye], near
    chosen = np.concatenate([directions[keep] for directions, keep in zip(rays, near, strict=True)])
    pixels = _FISHEYE.evaluate(fisheye, chosen).pixels
    starts = model.start_values(float(fisheye[:2].mean()), fisheye[2:4])
    return [model.matched(start, chosen, pixels) for start in starts], near
