"""What one shot says about one pallet: a pose with its covariance, or a reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from palletloc.geometry import FloatArray, LevelPose


class YawSource(StrEnum):
    """Which line gave the yaw."""

    BOTTOM = "bottom"
    """The lower edge of the front face."""
    TOP = "top"
    """The upper edge of the front face."""
    OPENING_TOP = "opening_top"
    """The upper edges of the fork openings."""
    OPENING_BOTTOM = "opening_bottom"
    """The lower edges of the fork openings."""
    FACE = "face"
    """The front face as a whole: no horizontal plane serves near the camera's height."""


@dataclass(frozen=True, slots=True)
class HeightPrior:
    """What is known of the height of a pallet's lower edge before it is measured."""

    z: float
    """Height above the floor, in metres."""
    sigma: float
    """Standard deviation, in metres."""


class Stage(StrEnum):
    """The step in which a candidate was given up."""

    START = "start"
    """A given start, before any step."""
    DETECTION = "detection"
    """Finding pallets on the shelf plane (paper's A)."""
    YAW = "yaw"
    """Yaw from the horizontal plane (B)."""
    POSITION = "position"
    """Position by the plane sweep (C)."""
    SEARCH = "search"
    """Scoring hypotheses around the start."""
    VERIFICATION = "verification"
    """The checks of the final pose."""


class Reason(StrEnum):
    """Why a candidate was given up. The texts stand in ``docs/refusals.md``."""

    UNKNOWN_MODEL = "unknown_model"
    """The start names a pallet model that the recording does not use."""
    NOT_FINITE = "not_finite"
    """The start has a value that is not a finite number."""
    OUT_OF_VIEW = "out_of_view"
    """The front face is not wholly inside what the camera sees."""
    BEHIND_FACE = "behind_face"
    """The camera is behind the front face or within a hand's breadth of its plane."""
    OUT_OF_RANGE = "out_of_range"
    """The face is farther away than ``max_range``."""
    NO_LINE = "no_line"
    """No boundary line was found on the horizontal plane and the face gives no yaw either."""
    NO_PEAK = "no_peak"
    """The sweep's best position lies at the end of its reach or nowhere."""
    FEW_EDGES = "few_edges"
    """Too few edges of the model are seen where the pose says they are."""
    HIDDEN = "hidden"
    """Something stands before most of the face."""
    LOW_CONTRAST = "low_contrast"
    """Openings and blocks do not differ as those of a pallet do."""
    OVERLAP = "overlap"
    """A better pallet stands in the same place."""
    YAW_DISAGREES = "yaw_disagrees"
    """The level lines turn the face otherwise than all its edges together do."""
    UNCERTAIN = "uncertain"
    """A pallet, but its pose is too uncertain to be of use."""
    OFF_LEVEL = "off_level"
    """The pose is not at any height where loads stand."""
    OTHER_MODEL = "other_model"
    """Another pallet of the library, which was not looked for, explains the image better."""


@dataclass(frozen=True, slots=True)
class PalletMeasurement:
    """The pose of one pallet from one shot."""

    time: float
    """When the shot was exposed, in seconds."""
    model: str
    """Name of the pallet model."""
    forklift_from_pallet: LevelPose
    """The pallet's pose at that time."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    score: float
    """How much the image speaks for a pallet there, 0 to 1: a rank among candidates."""
    yaw_from: YawSource
    """Which line gave the yaw."""
    file: str = ""
    """The shot's image, as the recording names it."""


@dataclass(frozen=True, slots=True)
class BetterModel:
    """Another pallet model that explains the image better."""

    name: str
    """Its name in the library."""
    nats: float
    """How much likelier it is, as a logarithm."""

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.name} is likelier by {self.nats:.1f} nats"


@dataclass(frozen=True, slots=True)
class RefusedCandidate:
    """A candidate of a shot that was given up: a row of refusals.csv."""

    time: float
    """When the shot was exposed, in seconds."""
    model: str
    """Name of the pallet model."""
    stage: Stage
    """The step that gave it up."""
    reason: Reason
    """Why."""
    file: str = ""
    """The shot's image, as the recording names it."""
    better: BetterModel | None = None
    """The model that explains the image better, where that is why; files of refusals do not hold it."""
