"""A pallet that the tracker follows: what is known of it, and how much it is believed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from palletloc.geometry import FloatArray, LevelPose
from palletloc.track_status import Status
from tracking.config import LifeConfig
from tracking.state import POSE, Gaussian, Key

RECALL = 8
"""Measurements of a track that rejected ones are counted against at most; after as many without one of its own, a
series is forgotten. Where every third is off, less than 4 % of the pauses are longer."""
MOST_SERIES = 3
"""How many series of rejected measurements are kept beside a track: the others are scattered."""


@dataclass(frozen=True, slots=True, eq=False)
class RejectedSeries:
    """Measurements in a track's place that its gate rejected and that agree with each other: another hypothesis."""

    state: Gaussian
    """What is known of the pallet by them."""
    model: str
    """The pallet model that they name."""
    hits: int
    """How many there are."""
    row: int
    """How many came in a row at last, without another measurement in the track's place."""
    lead: int
    """How many more there are than the track took in that time, of which up to `RECALL` before it count."""
    idle: int = 0
    """Measurements that the track took since the last of them."""
    mixed: bool = False
    """Whether the track took measurements since the first of them."""

    def joined(self, state: Gaussian) -> RejectedSeries:
        """Return the series with one more measurement, in the state after it."""
        return replace(self, state=state, hits=self.hits + 1, row=self.row + 1, lead=self.lead + 1, idle=0)

    def opposed(self) -> RejectedSeries:
        """Return the series after a measurement that the track took."""
        lead = max(self.lead - 1, -RECALL)
        return replace(self, row=0, lead=lead, idle=self.idle + 1, mixed=True)

    def outweighs(self, config: LifeConfig) -> bool:
        """Tell whether the pallet is where the series says, not where its track is.

        It is where so many came in a row that the pallet must have moved, or so many more than the track took that
        the track must have begun with what was the exception.

        Parameters
        ----------
        config : LifeConfig
            How many these are.
        """
        needed = config.recovery_hits
        return self.lead >= needed or (self.row >= needed and not self.mixed)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A pallet at the time of a shot; a value that never changes."""

    key: Key
    """Its name."""
    model: str
    """Name of the pallet model."""
    state: Gaussian
    """What the filter knows of it alone, at the time of the last shot."""
    seen: float
    """Time of its last measurement, in seconds."""
    hits: int = 1
    """How many measurements it is made of."""
    misses: int = 0
    """Shots in a row without one."""
    confirmed: bool = False
    """Whether it was seen often enough to be believed."""
    nis: float | None = None
    """Normalised innovation squared of its last measurement; None where none followed the first."""
    ratios: tuple[float, ...] = ()
    """The last ones over their degrees of freedom, each times the factor that the covariance had."""
    rejected: tuple[RejectedSeries, ...] = ()
    """Measurements in its place that its gate rejected, those together that agree with each other."""

    @property
    def is_contested(self) -> bool:
        """Whether as many rejected measurements agree with each other as it took in that time, or more."""
        return any(series.lead >= 0 for series in self.rejected)

    @property
    def pose(self) -> LevelPose:
        """``forklift_from_pallet``."""
        return LevelPose(*self.state.mean[POSE].tolist())

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of (x, y, z, yaw), in metres and radians."""
        return self.state.covariance[POSE, POSE]

    def moved(self, state: Gaussian) -> Track:
        """Return the track in another state; written out, for every shot does it for every track."""
        return Track(
            self.key,
            self.model,
            state,
            self.seen,
            self.hits,
            self.misses,
            self.confirmed,
            self.nis,
            self.ratios,
            self.rejected,
        )

    def status(self, time: float, config: LifeConfig) -> Status:
        """Return how much it is believed at a time.

        Parameters
        ----------
        time : float
            In seconds, at or after its last shot.
        config : LifeConfig
            When it coasts.
        """
        if not self.confirmed:
            return Status.TENTATIVE
        coasts = self.misses > 0 or time - self.seen > config.coast_after_s
        return Status.COASTING if coasts else Status.CONFIRMED

    def end(self, time: float, config: LifeConfig) -> str:
        """Return why it ends at a time; nothing where it goes on.

        Parameters
        ----------
        time : float
            In seconds, at or after its last shot.
        config : LifeConfig
            When tracks end.
        """
        if not self.confirmed and self.misses >= config.tentative_misses:
            return f"not seen in {self.misses} shots before it was confirmed"
        if self.is_too_old(time, config):
            return f"not seen for {time - self.seen:.3g} s"
        return ""

    def vague(self, config: LifeConfig) -> str:
        """Return why it is not worth keeping unless it is seen; nothing where its place is known well enough."""
        sigma = floor_sigma(self.state.covariance)
        return f"its place is known to {sigma:.2g} m only" if sigma > config.max_sigma_m else ""

    def is_too_old(self, time: float, config: LifeConfig) -> bool:
        """Tell whether its last measurement is too long ago."""
        return time - self.seen > (config.max_coast_s if self.confirmed else config.tentative_age_s)


def floor_sigma(covariance: FloatArray) -> float:
    """Return the standard deviation of a place on the floor, in metres: along the direction where it is largest.

    Parameters
    ----------
    covariance : (n, n) array
        Its first two numbers are x and y.
    """
    (xx, xy), (_, yy) = covariance[:2, :2].tolist()
    return math.sqrt((xx + yy) / 2 + math.hypot((xx - yy) / 2, xy))
