"""Parameters of the tracker, in one place, and their section ``tracker`` in the file of all parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tracking.odometry import OdometryNoise, PathLimits

if TYPE_CHECKING:
    from palletloc.io.config_file import Ranges


@dataclass(frozen=True, slots=True)
class MeasurementErrors:
    """How the errors of single shots belong together.

    Errors of a pallet's shots, in units of their stated sigma, agree by 0.4 to 0.6 of their variance within half a
    metre of way, by a third after one metre and by a fifth after two and a half: found on 25 recordings, two with
    scenes of their own, the others altered copies of them and synthetic ones. To share a part of every
    variance, beside these figures or in place of them, agreed no better.
    """

    common_position_m: float = 0.0025
    """Error of the place that a pallet's measurements share: what is unknown of mounting, level and model moves all
    of them alike, and does not average out. One standard deviation along each axis; 0 where there is none."""
    common_yaw_deg: float = 0.1
    """The same of the yaw, in degrees."""
    max_common_share: float = 0.8
    """Largest part of a measurement's variance that others share."""
    common_path_m: float = 1.5
    """Way of the forklift over which that falls to a third, as the view of the pallet changes."""
    wander_m: float = 0.001
    """How the place where a pallet is seen wanders as the view of it changes, along each axis, by the root of the way
    in metres: errors that last, and that no covariance of a single shot can state. Without it tracks would grow ever
    surer by shots that err alike."""
    wander_yaw_deg: float = 0.1
    """The same of the yaw, in degrees."""
    inflation: float = 1.0
    """Factor on all covariances that measurements state. 1: they are used as they are; more where successive shots
    share more than the figures above say."""
    latency_s: float = 0.0
    """How much later than the exposure a shot is stamped."""


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Which measurements may belong to a track, and how much they count."""

    probability: float = 0.9999
    """Part of a pallet's measurements that the gate lets pass. Errors have longer tails than a Gaussian's: what is
    far off counts less (`robust_probability`), and only what cannot belong to the pallet is shut out."""
    max_distance_m: float = 1.5
    """Farther from a track no measurement is compared with it."""
    robust_probability: float = 0.95
    """Part of a track's measurements that count in full; the Huber weight of the others falls with their distance."""
    adapt_over: int = 12
    """Over how many measurements innovations are compared with their covariance; 0 takes that as it is."""
    adapt_from: int = 3
    """After how many of them a covariance may be found too small; too large only after all."""
    adapt_probability: float = 0.99
    """How sure it must be that the covariances are wrong before they are scaled."""
    min_scale: float = 0.5
    """Smallest factor on a measurement's covariance."""
    max_scale: float = 9.0
    """Largest factor on a measurement's covariance."""


@dataclass(frozen=True, slots=True)
class LifeConfig:
    """When a track is believed, and when it ends."""

    confirm_hits: int = 3
    """Measurements until a track is confirmed."""
    tentative_misses: int = 3
    """Shots in a row without a measurement that end a track which is not confirmed."""
    tentative_age_s: float = 5.0
    """The same in seconds since its last measurement."""
    coast_after_s: float = 2.0
    """Time since its last measurement from which on a track coasts, even where no shot came in between."""
    max_coast_s: float = 60.0
    """Time since its last measurement after which a track is lost."""
    max_sigma_m: float = 0.5
    """Standard deviation of its place on the floor above which a track is lost."""
    recovery_hits: int = 3
    """Rejected measurements that agree with each other until the track begins anew from them: so many in a row, or so
    many more than the track took in that time."""


@dataclass(frozen=True, slots=True)
class WindowConfig:
    """Which inputs are in time."""

    window_s: float = 2.0
    """How late an input may be against the newest one; earlier ones are put in their place."""
    max_jump_s: float = 60.0
    """How long a pause may be. An input farther ahead than the window is held until another one follows it; beyond
    this, time itself must have jumped."""
    restart_inputs: int = 5
    """Inputs in a row, from another time but near each other, that are believed: the tracker starts anew."""


@dataclass(frozen=True, slots=True)
class LatencyConfig:
    """How the camera's latency is estimated."""

    search_s: float = 0.3
    """How far the camera's time may be off. Odometry that far around a shot is needed, inside the window."""
    span_s: float = 30.0
    """From how long ago on shots are compared."""
    spacing_s: float = 0.1
    """Least time between two shots that are kept."""
    max_sightings: int = 60
    """Measurements that are compared at most, taken evenly from all; the cost grows with their third power."""
    every: int = 10
    """After how many shots the estimate is made again."""
    max_gap_s: float = 0.25
    """Time between two samples of odometry above which speed in between is not known."""
    max_sigma_s: float = 0.03
    """Standard deviation above which nothing is said."""
    least_s: float = 0.005
    """Smallest latency worth an event."""
    significance: float = 3.0
    """How many standard deviations it has to be."""


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """Parameters of the tracker."""

    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    """What odometry cannot know."""
    estimate_odometry: bool = True
    """Whether its constant errors are estimated while driving, or only allowed for."""
    tracks_together: int = 5
    """How many tracks share one estimate at most, and with it what they tell of the forklift's motion. More gain
    little and cost more; with 1 every track is filtered alone."""
    path: PathLimits = field(default_factory=PathLimits)
    """What is believed of odometry."""
    errors: MeasurementErrors = field(default_factory=MeasurementErrors)
    """How the errors of single shots belong together."""
    gate: GateConfig = field(default_factory=GateConfig)
    """Which measurements belong to a track."""
    life: LifeConfig = field(default_factory=LifeConfig)
    """When a track is believed, and when it ends."""
    window: WindowConfig = field(default_factory=WindowConfig)
    """Which inputs are in time."""
    latency: LatencyConfig = field(default_factory=LatencyConfig)
    """How the camera's latency is estimated."""


SECTION = "tracker"
"""Key of the tracker's parameters in the file."""
_MEANING = "Pallets over time: what palletloc track adds to the measurements of single shots."
"""What the file says above the section."""
RANGES: Ranges = (
    ("adapt_over", 0, 1000),
    ("adapt_probability", 0.5, 1 - 1e-6),
    ("probability", 0.5, 1 - 1e-6),
    ("robust_probability", 0.5, 1 - 1e-6),
    ("min_scale", 0.01, 1),
    ("max_scale", 1, 1e4),
    ("max_common_share", 0, 0.99),
    ("common_path_m", 0.01, 1e4),
    ("latency_s", -10, 10),
    ("max_distance_m", 0.01, 100),
    ("max_speed_mps", 0.1, 100),
    ("max_turn_dps", 1, 3600),
    ("turn_acceleration_dps2", 0, 3600),
    ("max_ahead_s", 0, 60),
    ("tracks_together", 1, 50),
    ("window_s", 0.01, 600),
    ("max_jump_s", 0.1, 1e6),
    ("tentative_age_s", 0.01, 3600),
    ("coast_after_s", 0, 3600),
    ("max_coast_s", 0.01, 1e5),
    ("max_sigma_m", 0.001, 100),
    ("*_mm_per_sqrt_m", 0, 1000),
    ("*_mm_per_sqrt_s", 0, 1000),
    ("*", 0, 100),
)
"""Least and greatest value of each parameter, by its name; the first pattern that fits holds."""


def read_tracker_config(path: Path) -> TrackerConfig:
    """Read the tracker's parameters.

    Parameters
    ----------
    path : Path
        A yaml file, such as ``tracker: {life: {confirm_hits: 4}}``; its other sections are not looked at.

    Returns
    -------
    TrackerConfig
        The file's values, and the defaults of all others.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown (names the nearest), or a value is of the wrong kind or out of
        range; names the key.
    """
    from palletloc.io.config_file import read_section  # files are slow to import

    return read_section(path, SECTION, TrackerConfig, RANGES)


def format_tracker_config(config: TrackerConfig | None = None) -> str:
    """Return every parameter of the tracker as text that may follow `palletloc.io.config_file.format_config`.

    Parameters
    ----------
    config : TrackerConfig, optional
        The values; the defaults if left out.
    """
    from palletloc.io.config_file import format_section  # files are slow to import

    return format_section(SECTION, config or TrackerConfig(), _MEANING)
