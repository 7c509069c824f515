"""Measurements as the filter takes them: checked, with their errors split by what the next one shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from palletloc.geometry import BoolArray, FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement
from tracking.config import MeasurementErrors
from tracking.state import COMMON, POSE, SIZE
from tracking.validation import (
    LARGEST,
    BadInputError,
    beyond_reason,
    check_time,
    check_values,
    covariance_faults,
    numbers,
)

COMPONENTS = ("x", "y", "z", "yaw")
"""Names of the four numbers of a pallet's pose, in their order."""
ALL = (0, 1, 2, 3)
"""Their indices."""
YAW = 3
"""Index of the yaw."""


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
    H: FloatArray
    """(k, 10) derivative of the values by the pallet's state (`tracking.state`)."""
    own: FloatArray
    """(k, k) covariance of the rest, which is new in every measurement."""
    place_variance: float
    """Sum of the variances of the first three numbers, in square metres where they are a place."""
    common_variance: float
    """Sum of the squares of `common`."""
    place: tuple[float, float, float] | None
    """About where the pallet is, in metres; None where the measurement has no place."""
    order: str
    """Its place among the observations of a shot, whatever order they came in: made of all its numbers."""
    source: PalletMeasurement | PartialMeasurement
    """What it was made of."""

    @property
    def is_whole(self) -> bool:
        """Whether it gives a whole pose, from which a track may begin."""
        return self.components == ALL

    @property
    def pose(self) -> LevelPose:
        """``forklift_from_pallet`` of a whole pose."""
        return LevelPose(*self.values.tolist())


class _Given(NamedTuple):
    """The parts of a measurement."""

    source: PalletMeasurement | PartialMeasurement
    components: tuple[int, ...]
    values: FloatArray
    covariance: FloatArray
    pose: LevelPose | None


def observe(
    measurements: Sequence[PalletMeasurement | PartialMeasurement], errors: MeasurementErrors
) -> list[Observation | BadInputError]:
    """Check measurements and ready them for the filter.

    Parameters
    ----------
    measurements : sequence of PalletMeasurement or PartialMeasurement
        As the localizer gives them.
    errors : MeasurementErrors
        What measurements share, and how much later than the exposure they are stamped.

    Returns
    -------
    list of Observation or BadInputError
        With the times of the exposures; what is wrong where a number is not finite or beyond all reason, or the
        covariance is not symmetric positive definite.
    """
    found: dict[int, Observation | BadInputError] = {}
    groups: dict[tuple[int, ...], dict[int, _Given]] = {}
    for number, measurement in enumerate(measurements):
        try:
            given = _given(measurement)
        except BadInputError as fault:
            found[number] = fault
        else:
            groups.setdefault(given.components, {})[number] = given
    for components, group in groups.items():
        ready = _observed(components, list(group.values()), errors)
        found.update(zip(group, ready, strict=True))
    return [found[number] for number in range(len(measurements))]


def _given(measurement: PalletMeasurement | PartialMeasurement) -> _Given:
    """Return the parts of a measurement; raise where a part has another form."""
    time = measurement.time
    check_time(time)
    if isinstance(measurement, PalletMeasurement):
        pose: LevelPose | None = measurement.forklift_from_pallet
        components: tuple[int, ...] = ALL
        values = numbers("pose", measurement.forklift_from_pallet.as_array(), (4,), time)
    else:
        components, values, pose = _part(measurement)
    size = len(components)
    return _Given(
        measurement, components, values, numbers("covariance", measurement.covariance, (size, size), time), pose
    )


def _part(measurement: PartialMeasurement) -> tuple[tuple[int, ...], FloatArray, LevelPose | None]:
    names, time = measurement.components, measurement.time
    indices = tuple(COMPONENTS.index(name) for name in names if name in COMPONENTS)
    if not names or len(indices) < len(names) or list(indices) != sorted(set(indices)):
        raise BadInputError("components", time, f"expected some of {COMPONENTS} in order, got {names}")
    values = numbers("values", measurement.values, (len(names),), time)
    near = measurement.near
    if near is not None:
        check_values("near", near.as_array(), time)
    elif indices[:3] == (0, 1, 2):
        x, y, z, *yaw = values.tolist()
        near = LevelPose(x, y, z, *(yaw or [0.0]))
    return indices, values, near


def _observed(
    components: tuple[int, ...], group: Sequence[_Given], errors: MeasurementErrors
) -> list[Observation | BadInputError]:
    """Return observations with the same components: all at once."""
    values = np.array([given.values for given in group]) + 0.0  # no negative zero
    covariances = np.array([given.covariance for given in group]) + 0.0
    faults = covariance_faults(covariances)
    usable: BoolArray = np.all(np.abs(values) < LARGEST, axis=1)  # false for nan, too
    sound = [i for i, fault in enumerate(faults) if usable[i] and not fault]
    found: dict[int, Observation | BadInputError] = {}
    for i in sorted(set(range(len(group))) - set(sound)):
        what, why = ("covariance", faults[i]) if usable[i] else ("pose", beyond_reason(values[i]))
        found[i] = BadInputError(what, group[i].source.time, why)
    if sound:
        ready = _ready(components, [group[i] for i in sound], values[sound], covariances[sound], errors)
        found.update(zip(sound, ready, strict=True))
    return [found[i] for i in range(len(group))]


def _ready(
    components: tuple[int, ...],
    group: Sequence[_Given],
    values: FloatArray,
    covariances: FloatArray,
    errors: MeasurementErrors,
) -> list[Observation]:
    covariances = errors.inflation * (covariances + covariances.transpose(0, 2, 1)) / 2
    if components[-1] == YAW:
        values[:, -1] = wrap_angle(values[:, -1])
    given = [part.pose or LevelPose(0.0, 0.0, 0.0, 0.0) for part in group]
    poses = np.array([(pose.x, pose.y, pose.z, pose.yaw) for pose in given]) + 0.0
    commons = _commons(covariances, components, poses[:, YAW], errors)
    owns = covariances - commons @ commons.transpose(0, 2, 1)
    by_state = np.zeros((len(group), len(components), SIZE))
    by_state[:, :, POSE], by_state[:, :, COMMON] = _picked(components), commons
    spreads = np.einsum("nii->ni", covariances)[:, :3].sum(axis=1).tolist()
    squares = (commons * commons).sum(axis=(1, 2)).tolist()
    rows = zip(group, values, covariances, commons, by_state, owns, spreads, squares, poses, strict=True)
    return [
        Observation(
            part.source.time - errors.latency_s,
            part.source.model,
            components,
            value,
            covariance,
            common,
            H,
            own,
            spread,
            square,
            None if part.pose is None else (part.pose.x, part.pose.y, part.pose.z),
            _order(part.source.model, components, value, covariance, pose[:0] if part.pose is None else pose),
            part.source,
        )
        for part, value, covariance, common, H, own, spread, square, pose in rows
    ]


def _order(model: str, components: tuple[int, ...], values: FloatArray, *others: FloatArray) -> str:
    """Return a text by which observations of a shot are put in order: the nearest ahead first."""
    content = b"".join([values.tobytes(), *[other.tobytes() for other in others]])
    return f"{model} {components} {values[0] + LARGEST:014.6f} {content.hex()}"


def _commons(
    covariances: FloatArray, components: tuple[int, ...], headings: FloatArray, errors: MeasurementErrors
) -> FloatArray:
    """Return the symmetric roots of the shared parts of covariances, (n, k, 4), in the pallets' axes.

    The shared part is what the parameters say, cut to the largest share in every direction. In these axes it changes
    little from one view to the next, so that the same unit of error means the same thing.
    """
    sigmas = np.array([errors.common_position_m] * 3 + [math.radians(errors.common_yaw_deg)])[list(components)]
    axes = np.tile(np.eye(len(components)), (len(headings), 1, 1))
    if components[:2] == (0, 1):
        cos, sin = np.cos(headings), np.sin(headings)
        axes[:, 0, 0] = axes[:, 1, 1] = cos
        axes[:, 0, 1], axes[:, 1, 0] = -sin, sin
    turned = axes.transpose(0, 2, 1) @ covariances @ axes
    roots = np.tile(np.diag(sigmas), (len(headings), 1, 1))
    large = np.linalg.eigvalsh(errors.max_common_share * turned - np.diag(sigmas**2))[:, 0] < 0
    if large.any():
        roots[large] = _cut(turned[large], sigmas, errors.max_common_share)
    return np.asarray(axes @ roots @ _picked(components))


def _cut(covariances: FloatArray, sigmas: FloatArray, most: float) -> FloatArray:
    """Return the symmetric roots of what is shared where that is more than the largest share in some direction."""
    wholes = np.linalg.cholesky(covariances)
    halves = np.linalg.solve(wholes, np.broadcast_to(np.diag(sigmas**2), wholes.shape))
    shares, directions = np.linalg.eigh(np.linalg.solve(wholes, halves.transpose(0, 2, 1)))
    parts = wholes @ directions * np.sqrt(np.clip(shares, 0.0, most))[:, None]
    variances, vectors = np.linalg.eigh(parts @ parts.transpose(0, 2, 1))
    return np.asarray(vectors * np.sqrt(np.maximum(variances, 0.0))[:, None] @ vectors.transpose(0, 2, 1))


@lru_cache(maxsize=16)
def _picked(components: tuple[int, ...]) -> FloatArray:
    """Return the (k, 4) matrix that picks components of a pose."""
    rows = np.eye(4)[list(components)]
    rows.flags.writeable = False
    return rows


@dataclass(frozen=True, slots=True)
class ShotTaken:
    """A shot: without a measurement of a pallet in it, that pallet was not seen."""

    time: float
    """When it was exposed, in seconds."""

    def checked(self, latency: float) -> ShotTaken:
        """Return it with the time of the exposure.

        Parameters
        ----------
        latency : float
            How much later than the exposure it is stamped, in seconds.

        Raises
        ------
        BadInputError
            If its time is not finite.
        """
        check_time(self.time)
        return ShotTaken(self.time - latency)
