"""What one shot says about one pallet: a pose with its covariance, or a reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from palletloc.geometry import FloatArray, LevelPose

_REAL = (float, int, np.floating, np.integer)
"""What a number may be."""
_ASYMMETRY = 1e-6
"""How much two numbers of a covariance that should be equal may differ, as a part of the geometric mean of their
variances: files have seven digits, and rounding in an inverse leaves less."""
_LEAST_CORRELATION = -1e-5
"""Smallest eigenvalue of the correlations of a covariance with seven digits."""


def covariance_fault(given: object) -> str:
    """Return what is wrong with the covariance of a pose; nothing where it is one.

    Parameters
    ----------
    given : (4, 4) array
        As it came; zero where nothing is stated.

    Returns
    -------
    str
        What was expected, where it is not real, finite, symmetric and positive semidefinite.

    Examples
    --------
    >>> covariance_fault(np.diag([1e-4, 1e-4, 0.0, 1e-4]))
    ''
    >>> covariance_fault(np.diag([1e-4, 1e-4, -1e-4, 1e-4]))
    'expected a positive semidefinite matrix'
    """
    if not isinstance(given, np.ndarray) or given.shape != (4, 4) or given.dtype.kind not in "fiu":
        what = f"an array of {given.dtype} {given.shape}" if isinstance(given, np.ndarray) else type(given).__name__
        return f"expected 4 x 4 real numbers, got {what}"
    if not np.isfinite(given).all():
        return "expected finite numbers"
    variances = given.diagonal().astype(np.float64)
    scale = np.sqrt(np.maximum(variances, 1e-300))
    with np.errstate(over="ignore"):  # beside a variance that is next to none
        correlations = given / scale / scale[:, None]
    bounded = np.clip(correlations, -2.0, 2.0)
    if (np.abs(bounded - bounded.T) > _ASYMMETRY).any():
        return "expected a symmetric matrix"
    if variances.min() < 0 or np.linalg.eigvalsh(bounded)[0] < _LEAST_CORRELATION:
        return "expected a positive semidefinite matrix"
    return ""


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

    def __post_init__(self) -> None:
        """Refuse what no measurement can state."""
        given: dict[str, Any] = {name: getattr(self, name) for name in ("model", "file", "score")}
        model, file, score = given.values()
        if not isinstance(model, str) or not model:
            raise ValueError(f"model: expected the name of a pallet model, got {model!r:.60}")
        if not isinstance(file, str):
            raise ValueError(f"file: expected a text, got {file!r:.60}")
        if isinstance(score, bool) or not isinstance(score, _REAL) or not 0 <= score <= 1:
            raise ValueError(f"score: expected a number from 0 to 1, got {score!r:.60}")
        if problem := covariance_fault(self.covariance):
            raise ValueError(f"covariance: {problem}")


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
