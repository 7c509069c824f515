"""Measured poses against true ones, in the directions that matter to a forklift."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.io.truth import Truth
from palletloc.measurement import PalletMeasurement, YawSource

REACH = 0.5
"""How far from a true pallet a measurement may be to belong to it, in metres."""


@dataclass(frozen=True, slots=True)
class PlacedPallet:
    """A true pallet as the forklift has it before itself at some time."""

    name: str
    """Its name in the scene."""
    model: str
    """Name of its model."""
    forklift_from_pallet: LevelPose
    """Where it is."""
    range: float
    """Distance of the middle of its front's lower edge from the camera, in metres."""


@dataclass(frozen=True, slots=True)
class PoseError:
    """How far a measured pallet is from the true one: measured minus true, in the true pallet's directions."""

    time: float
    """When the shot was exposed, in seconds."""
    file: str
    """The shot's image."""
    pallet: str
    """Name of the true pallet."""
    model: str
    """Name of the measured model."""
    yaw_from: YawSource
    """Which line gave the yaw."""
    range: float
    """Distance of the true pallet from the camera, in metres."""
    offset: FloatArray
    """(4,) depth (into the shelf), along (to the pallet's left), height, in metres, and yaw in radians."""
    sigma: FloatArray
    """(4,) what the measurement says of the same four numbers: standard deviations."""

    @property
    def is_covered(self) -> FloatArray:
        """(4,) 1 where the error is within two standard deviations, else 0."""
        return (np.abs(self.offset) <= 2 * self.sigma).astype(np.float64)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measurements of a recording against its truth."""

    errors: tuple[PoseError, ...]
    """In the measurements' order."""
    unmatched: tuple[PalletMeasurement, ...]
    """Measurements where no pallet stands."""


def placed_pallets(truth: Truth, time: float, camera_center: FloatArray) -> tuple[PlacedPallet, ...]:
    """Return the true pallets in the forklift frame.

    Parameters
    ----------
    truth : Truth
        Of the recording.
    time : float
        In seconds.
    camera_center : (3,) array
        The camera in the forklift frame, in metres.

    Raises
    ------
    TrajectoryError
        If the truth does not cover the time.
    """
    forklift_from_world = truth.forklift.pose_at(time).transform().inv()
    poses = [level_pose(forklift_from_world * one.world_from_pallet.transform()) for one in truth.pallets]
    return tuple(
        PlacedPallet(one.id, one.model, pose, float(np.linalg.norm(pose.as_array()[:3] - np.asarray(camera_center))))
        for one, pose in zip(truth.pallets, poses, strict=True)
    )


def compare(measurements: Iterable[PalletMeasurement], truth: Truth, camera_center: FloatArray) -> Comparison:
    """Compare measurements with the truth.

    Parameters
    ----------
    measurements : iterable of PalletMeasurement
        Of any number of shots.
    truth : Truth
        Of the recording.
    camera_center : (3,) array
        The camera in the forklift frame, in metres.

    Returns
    -------
    Comparison
        A measurement belongs to the nearest true pallet within `REACH`, and none to one that has a nearer.
    """
    by_time: dict[float, list[PalletMeasurement]] = {}
    for one in measurements:
        by_time.setdefault(one.time, []).append(one)
    errors: list[PoseError] = []
    unmatched: list[PalletMeasurement] = []
    for time, found in by_time.items():
        matched = _match(found, placed_pallets(truth, time, camera_center))
        errors += [pose_error(found[i], matched[i]) for i in sorted(matched)]
        unmatched += [measured for i, measured in enumerate(found) if i not in matched]
    return Comparison(tuple(errors), tuple(unmatched))


def _match(found: Sequence[PalletMeasurement], pallets: Sequence[PlacedPallet]) -> dict[int, PlacedPallet]:
    """Return the true pallet of each measurement that has one, by the measurement's index."""
    pairs = [
        (_distance(measured, pallet), i, k) for i, measured in enumerate(found) for k, pallet in enumerate(pallets)
    ]
    matched: dict[int, PlacedPallet] = {}
    taken: set[int] = set()
    for distance, i, k in sorted(pairs):
        if distance <= REACH and i not in matched and k not in taken:
            matched[i] = pallets[k]
            taken.add(k)
    return matched


def _distance(measured: PalletMeasurement, pallet: PlacedPallet) -> float:
    apart = measured.forklift_from_pallet.as_array() - pallet.forklift_from_pallet.as_array()
    return float(np.linalg.norm(apart[:3]))


def pose_error(measured: PalletMeasurement, pallet: PlacedPallet) -> PoseError:
    """Return how far a measurement is from the true pallet.

    Parameters
    ----------
    measured : PalletMeasurement
        The measurement.
    pallet : PlacedPallet
        The pallet at the same time.
    """
    true = pallet.forklift_from_pallet
    cos, sin = float(np.cos(true.yaw)), float(np.sin(true.yaw))
    turn = np.array([[cos, sin, 0, 0], [-sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    apart = measured.forklift_from_pallet.as_array() - true.as_array()
    apart[3] = wrap_angle(float(apart[3]))
    return PoseError(
        measured.time,
        measured.file,
        pallet.name,
        measured.model,
        measured.yaw_from,
        pallet.range,
        turn @ apart,
        np.sqrt(np.diag(turn @ measured.covariance @ turn.T)),
    )
