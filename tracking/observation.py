"""Measurements as the filter takes them: checked, with their errors split by what the next one shares."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import PalletMeasurement
from tracking.config import MeasurementErrors
from tracking.faults import LARGEST, BadInputError, check_time, checked_covariance

COMPONENTS = ("x", "y", "z", "yaw")
"""Names of the four numbers of a pallet's pose, in their order."""
ALL = (0, 1, 2, 3)
"""Their indices."""


@dataclass(frozen=True, slots=True, eq=False)
class PartialMeasurement:
    """Some of the numbers of a pallet's pose from one shot."""

    time: float
    """When the shot was exposed, in seconds."""
    model: str
    """Name of the pallet model."""
    components: tuple[str, ...]
    """Which of `COMPONENTS`, in their order: ``("yaw",)``, ``("x", "y", "z")``."""
    values: FloatArray
    """(k,) the numbers, in the forklift frame, in metres and radians."""
    covariance: FloatArray
    """(k, k) their covariance."""
    near: LevelPose | None = None
    """About where the pallet is, by which the track is chosen that it belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A measurement ready for the filter."""

    time: float
    """When the shot was exposed, in seconds."""
    model: str
    """Name of the pallet model."""
    components: tuple[int, ...]
    """(k) which of x, y, z and yaw."""
    values: FloatArray
    """(k,) their values, the yaw in [-pi, pi)."""
    covariance: FloatArray
    """(k, k) their covariance, inflated."""
    common: FloatArray
    """(k, 4) what a unit of the error moves that this pallet's measurements share, along the pallet's axes."""
    own: FloatArray
    """(k, k) covariance of the rest, which is new in every measurement."""
    place: tuple[float, float, float] | None
    """About where the pallet is, in metres; None where the measurement does not tell."""
    order: tuple[object, ...]
    """Its place among the observations of a shot, whatever order they came in: all that it says."""
    source: PalletMeasurement | PartialMeasurement
    """What it was made of."""

    @property
    def is_whole(self) -> bool:
        """Whether it gives a whole pose, from which a track may begin."""
        return self.components == ALL

    @property
    def pose(self) -> LevelPose:
        """``forklift_from_pallet`` of a whole pose."""
        return LevelPose(*(float(value) for value in self.values))


def observe(measurement: PalletMeasurement | PartialMeasurement, errors: MeasurementErrors) -> Observation:
    """Check a measurement and ready it for the filter.

    Parameters
    ----------
    measurement : PalletMeasurement or PartialMeasurement
        As the localizer gives it.
    errors : MeasurementErrors
        What measurements share, and how much later than the exposure they are stamped.

    Returns
    -------
    Observation
        With the time of the exposure.

    Raises
    ------
    BadInputError
        If a number is not finite or beyond all reason, or the covariance is not symmetric positive definite.
    """
    if isinstance(measurement, PalletMeasurement):
        components: tuple[int, ...] = ALL
        values = measurement.forklift_from_pallet.as_array()
        pose: LevelPose | None = measurement.forklift_from_pallet
    else:
        components, values, pose = _part(measurement)
    time = measurement.time
    check_time(time)
    if not (np.isfinite(values).all() and np.abs(values).max() < LARGEST):
        raise BadInputError("pose", time, f"expected finite numbers below {LARGEST:g}, got {values.tolist()}")
    covariance = errors.inflation * checked_covariance(measurement.covariance, len(components), time)
    values = values.copy()
    if 3 in components:
        at = components.index(3)
        values[at] = (values[at] + math.pi) % (2 * math.pi) - math.pi
    place = None if pose is None else (pose.x, pose.y, pose.z)
    common = _common(covariance, components, pose, errors)
    own = covariance - common @ common.T
    order = (measurement.model, components, tuple(values.tolist()), tuple(covariance.ravel().tolist()))
    return Observation(
        time - errors.latency_s,
        measurement.model,
        components,
        values,
        covariance,
        common,
        own,
        place,
        order,
        measurement,
    )


def _part(measurement: PartialMeasurement) -> tuple[tuple[int, ...], FloatArray, LevelPose | None]:
    names = measurement.components
    known = [name in COMPONENTS for name in names]
    indices = tuple(COMPONENTS.index(name) for name, good in zip(names, known, strict=True) if good)
    if not names or not all(known) or list(indices) != sorted(set(indices)):
        raise BadInputError("components", measurement.time, f"expected some of {COMPONENTS} in order, got {names}")
    values = np.asarray(measurement.values, dtype=np.float64)
    if values.shape != (len(names),):
        raise BadInputError("values", measurement.time, f"expected {len(names)} numbers, got {values.shape}")
    near = measurement.near
    if near is not None and not np.isfinite(near.as_array()).all():
        raise BadInputError("near", measurement.time, "expected finite numbers")
    if near is None and indices[:3] == (0, 1, 2):
        x, y, z = (float(value) for value in values[:3])
        near = LevelPose(x, y, z, 0.0)
    return indices, values, near


def _common(
    covariance: FloatArray, components: tuple[int, ...], pose: LevelPose | None, errors: MeasurementErrors
) -> FloatArray:
    """Return the symmetric root of the shared part of a covariance, in the pallet's axes.

    The shared part is what the parameters say, cut to the largest share in every direction. In these axes it changes
    little from one view to the next, so that the same unit of error means the same thing.
    """
    sigmas = np.array([errors.common_position_m] * 3 + [math.radians(errors.common_yaw_deg)])
    turn = np.eye(4)
    if pose is not None and components[:2] == (0, 1):
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
    axes = turn[np.ix_(components, components)]
    whole: FloatArray = np.linalg.cholesky(axes.T @ covariance @ axes).astype(np.float64)
    shares, directions = np.linalg.eigh(_whitened(whole, np.diag(sigmas[list(components)] ** 2)))
    part = whole @ directions * np.sqrt(np.clip(shares, 0.0, errors.max_common_share))
    shared: FloatArray = (part @ part.T).astype(np.float64)
    variances, vectors = np.linalg.eigh(shared)
    root = (vectors * np.sqrt(np.maximum(variances, 0.0))) @ vectors.T
    return np.asarray(axes @ root @ np.eye(4)[list(components)])


def _whitened(root: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return a covariance in units of another one, whose Cholesky root is given."""
    half = np.linalg.solve(root, covariance)
    return np.asarray(np.linalg.solve(root, half.T))


@lru_cache(maxsize=16)
def picked(components: tuple[int, ...]) -> FloatArray:
    """Return the (k, 4) matrix that picks components of a pose."""
    rows = np.eye(4)[list(components)]
    rows.flags.writeable = False
    return rows
