"""From fitted lenses to a camera: one lens, or two back to back in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.findings import Finding, Severity
from calibration.lenses.fit import LensFit
from calibration.lenses.models import LensCamera
from palletloc.cameras import CameraModel, DualFisheye, FisheyeLens, KannalaBrandt
from palletloc.geometry import FloatArray

_MARGIN = float(np.radians(1.0))
"""How much farther than its corners a lens sees, in radians: the model is not known beyond."""
_WIDE_MARGINS = tuple(float(np.radians(angle)) for angle in (20.0, 10.0, 5.0, 2.0, 0.0))
"""The same to measure corners again, in radians: as far as the numbers describe a lens."""


_SEEN_PX = 1e-3
"""A corner that the camera shows farther from the fit than this is folded over: rounding makes 1e-9."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedCamera:
    """The camera of a fit."""

    lenses: tuple[LensCamera, ...]
    """Each lens in its own frame."""
    camera_from_lens: tuple[RigidTransform, ...]
    """Where they are in the camera frame."""

    @property
    def camera(self) -> CameraModel:
        """The whole camera."""
        if len(self.lenses) == 1:
            return self.lenses[0]
        front, back = (
            FisheyeLens(lens, pose)
            for lens, pose in zip(self.lenses, self.camera_from_lens, strict=True)
            if isinstance(lens, KannalaBrandt)
        )
        return DualFisheye(front, back)


def fitted_camera(fit: LensFit, size: tuple[int, int], max_angle: float | None) -> FittedCamera | Finding:
    """Return the camera of a fit, or the finding that its numbers describe none.

    Parameters
    ----------
    fit : LensFit
        The result.
    size : (int, int)
        Width and height of the shots, in pixels.
    max_angle : float, optional
        How far the lenses see, in radians; else a degree farther than the corners reach.
    """
    try:
        lenses = _lenses(fit, size, _MARGIN, max_angle)
    except ValueError as error:
        how = "take shots with boards up to the rim of the image, or choose eucm or double_sphere"
        return Finding(Severity.FAIL, "not_invertible", f"the fitted numbers describe no lens: {error}", how)
    fitted = FittedCamera(lenses, _in_camera([fit.rig.lenses[i] for i in range(len(lenses))]))
    return _unseen_corners(fit, fitted.lenses) or fitted


def _unseen_corners(fit: LensFit, cameras: Sequence[LensCamera]) -> Finding | None:
    """Return the finding that a camera does not show the corners as the fit does, or None."""
    worst = 0
    for view, used, residual in zip(fit.problem.views, fit.used, fit.residuals, strict=True):
        shown = cameras[view.lens].project(fit.rig.lens_from_board(view).apply(view.points)).pixels
        off = np.linalg.norm(shown - view.pixels - residual, axis=-1)
        # A corner at the very border of the image may lie on it in truth and off it by the fit.
        at_border = np.isnan(off) & (np.linalg.norm(residual, axis=-1) > _border_distance(view.pixels, cameras[0]))
        worst += int((used & ~at_border & ~(off < _SEEN_PX)).sum())
    if not worst:
        return None
    what = f"the fitted lens folds: {worst} corners lie where it is not one to one"
    how = "take shots with boards up to the rim of the image, or choose a model with fewer terms"
    return Finding(Severity.FAIL, "not_invertible", what, how)


def _border_distance(pixels: FloatArray, camera: LensCamera) -> FloatArray:
    sides = np.array([camera.width - 0.5, camera.height - 0.5]) - pixels
    distance: FloatArray = np.minimum(sides.min(-1), (pixels + 0.5).min(-1))
    return distance


def measuring_lenses(fit: LensFit, size: tuple[int, int]) -> tuple[LensCamera, ...] | None:
    """Return the lenses of a fit that see as far around the corners as they can, to measure the corners again.

    Parameters
    ----------
    fit : LensFit
        The result.
    size : (int, int)
        Width and height of the shots, in pixels.

    Returns
    -------
    tuple of LensCamera, optional
        None where the numbers describe no lens as far as the corners reach.
    """
    for margin in _WIDE_MARGINS:
        try:
            return _lenses(fit, size, margin, None)
        except ValueError:
            continue
    return None


def _lenses(fit: LensFit, size: tuple[int, int], margin: float, max_angle: float | None) -> tuple[LensCamera, ...]:
    """Return the lenses, seeing so far beyond their corners, or so far in all."""
    lenses = []
    for lens, (model, values) in enumerate(zip(fit.problem.models, fit.rig.values, strict=True)):
        rays = fit.corner_rays(lens)
        reach = float(np.arctan2(np.hypot(rays[:, 1], rays[:, 2]), rays[:, 0]).max())
        lenses.append(model.camera(values, size, max_angle or min(reach + margin, float(np.pi))))
    return tuple(lenses)


def _in_camera(lenses: Sequence[RigidTransform]) -> tuple[RigidTransform, ...]:
    """Return the lenses in a frame midway between them: x along the front lens, z up in the image of both."""
    if len(lenses) == 1:
        return tuple(lenses)
    turns = np.stack([lens.rotation.as_matrix() for lens in lenses])
    forward = _unit(turns[0, :, 0] - turns[1, :, 0])
    up = turns[0, :, 2] + (turns[1, :, 2] if turns[0, :, 2] @ turns[1, :, 2] > 0 else 0.0)
    left = _unit(np.cross(up, forward))
    axes = np.stack([forward, left, np.cross(forward, left)], axis=1)
    middle = np.mean([lens.translation for lens in lenses], axis=0)
    camera = RigidTransform.from_components(middle, Rotation.from_matrix(axes))
    return tuple(camera.inv() * lens for lens in lenses)


def _unit(vector: FloatArray) -> FloatArray:
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit
