"""What is evaluated: poses of pallets with covariances, whoever made them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import PalletMeasurement


class EstimatedPallet(Protocol):
    """A pose of a pallet with its covariance, from a shot or a track."""

    @property
    def time(self) -> float:
        """When it holds, in seconds."""

    @property
    def model(self) -> str:
        """Name of the pallet model."""

    @property
    def forklift_from_pallet(self) -> LevelPose:
        """The pallet's pose at that time."""

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""


@dataclass(frozen=True, slots=True, eq=False)
class PalletEstimate:
    """A row of measurements.csv or tracks.csv, as far as the evaluation needs it."""

    time: float
    """When it holds, in seconds."""
    model: str
    """Name of the pallet model."""
    forklift_from_pallet: LevelPose
    """The pallet's pose at that time."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    track: str = ""
    """Name of the track; empty for a single shot."""
    state: str = ""
    """State of the track; empty for a single shot."""
    file: str = ""
    """The shot's image; empty where it is not known."""


def from_measurements(measurements: Iterable[PalletMeasurement]) -> list[PalletEstimate]:
    """Return single-shot measurements as estimates, in their order."""
    return [
        PalletEstimate(one.time, one.model, one.forklift_from_pallet, one.covariance, file=one.file)
        for one in measurements
    ]


def without_state(estimates: Iterable[PalletEstimate], state: str = "tentative") -> list[PalletEstimate]:
    """Return the estimates that are not in a state: a tentative track does not claim to be a pallet yet."""
    return [one for one in estimates if one.state != state]
