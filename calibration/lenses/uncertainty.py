"""How well bearings are known with a fitted lens: the covariance of its parameters, seen where it matters."""

from __future__ import annotations

import numpy as np

from calibration.bearings import cross_matrices
from calibration.lenses.models import LensModel
from palletloc.geometry import FloatArray

_AZIMUTHS = 16


def bearing_sigma(model: LensModel, values: FloatArray, covariance: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the standard deviation of bearings at angles off axis, in radians, the largest around the axis.

    A common rotation of all bearings is left out: it belongs to the mounting.

    Parameters
    ----------
    model : LensModel
        Of the lens.
    values : (k,) array
        Its parameters.
    covariance : (k, k) array
        Their covariance.
    angles : (n,) array
        Off axis, in radians; the model must image them.
    """
    around = 2 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    angle, azimuth = (one.ravel() for one in np.meshgrid(angles, around, indexing="ij"))
    rays = np.stack([np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)], axis=-1)
    imaged = model.evaluate(values, rays)
    # How a bearing turns when its pixel moves: the inverse of the derivative, across the ray.
    across = np.linalg.pinv(imaged.by_ray)
    moved = (across @ imaged.by_values).reshape(-1, len(values))
    turned = -cross_matrices(rays).reshape(-1, 3)
    moved = moved - turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
    by_ray = moved.reshape(len(rays), 3, -1)
    variance = np.einsum("nij,jk,nik->ni", by_ray, covariance, by_ray).sum(-1)
    sigma: FloatArray = np.sqrt(variance).reshape(len(angles), -1).max(-1)
    return sigma
