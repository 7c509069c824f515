"""Is it a pallet, and is its pose of use? Checks that the fit of the edges cannot make.

A beam with cartons, or a pallet shifted by one opening, has edges where the drawing wants them. What tells them
from a pallet are several weak signs, each of them evidence: openings that differ from the blocks beside them, edges
all along their length, agreement with the drawing, and no edge that contradicts the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.measurement import Reason

CONTRAST, SCORE, COVERAGE, DOUBT = 1.5, 5.0, 4.0, -0.8
"""Evidence per factor e of contrast and of doubt, and per unit of score and coverage, in nats.

About the logarithm of how much more often pallets show such a value than other places do, over synthetic scenes of
all kinds of light, pallets, cameras and noise.
"""
USUAL_CONTRAST, USUAL_SCORE, USUAL_COVERAGE, USUAL_DOUBT = 2.0, 0.5, 0.65, 3.0
"""What pallets and other places show equally often."""
NO_CONTRAST = 3.0
"""Evidence per factor e of a contrast below the usual one: few pallets have openings like their blocks."""
HIDDEN, EXPLAINED = -10.0, 7.0
"""Evidence of a face that is wholly hidden: what seems to be hidden may as well not be there; and how much less it
says where something is seen to stand there."""
WEAK_DOUBT = 0.5
"""Doubt from which on a covariance grows where only the face gives yaw or distance."""
NATS_PER_EDGE = 2.0
"""How much less likely, as a logarithm, each missing or contradicting edge makes a pose."""
ENOUGH_PX = 80.0
"""Width of a face in the image below which all signs say less: few pixels look like anything."""
CLEAR_CONTRAST = 4.0
"""Contrast from which on more says nothing more."""


@dataclass(frozen=True, slots=True)
class VerificationConfig:
    """What a pallet must show, and how well its pose must be known."""

    min_promise: float = 0.45
    """Least product of a detection's score and its contrast for it to be measured."""
    min_rank: float = 0.65
    """Least probability that it is a pallet."""
    certain: float = 0.9
    """Probability from which on no other candidate is tried in a pallet's place."""
    max_sigma: float = 0.08
    """Largest standard deviation of a position on the floor that is of use, in metres."""
    max_yaw_sigma_deg: float = 1.0
    """Largest standard deviation of a yaw that is of use, in degrees."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the face shows at a pose, and how much that speaks for a pallet."""

    contrast: float
    """Difference of the less clear opening from the blocks beside it, in spreads of the blocks."""
    coverage: float
    """Part of the face's edges that is seen, of those that nothing hides, 0 to 1."""
    score: float
    """Agreement of face and drawing where nothing hides it, at most 1."""
    doubt: float
    """How many edges are missing or contradict the others."""
    hidden: float = 0.0
    """Part of the face that something seems to stand before, 0 to 1."""
    explained: float = 0.0
    """That part of it where what stands before the face is seen, too."""
    width_px: float = math.inf
    """Width of the face in the image, in pixels."""

    @property
    def parts(self) -> tuple[float, float]:
        """Evidence for a pallet from what lies between the edges, and from the edges, in nats."""
        contrast = math.log(min(max(self.contrast, 0.2), CLEAR_CONTRAST) / USUAL_CONTRAST)
        between = (CONTRAST if contrast > 0 else NO_CONTRAST) * contrast
        edges = SCORE * (min(max(self.score, 0.0), 1.0) - USUAL_SCORE) + COVERAGE * (self.coverage - USUAL_COVERAGE)
        missing = DOUBT * math.log((max(self.doubt, 0.0) + 0.5) / USUAL_DOUBT)
        missing += HIDDEN * self.hidden + EXPLAINED * self.explained
        return between, edges + missing

    @property
    def total(self) -> float:
        """How much all signs together speak for a pallet, in nats."""
        total = sum(self.parts)
        return total if total < 0 else total * min(1.0, self.width_px / ENOUGH_PX)

    @property
    def visible(self) -> float:
        """The same without what stands before it: of two places for one pallet more of the better one is seen."""
        return sum(replace(self, explained=0.0).parts)

    @property
    def probability(self) -> float:
        """Probability that it is a pallet, where places with and without one are equally frequent."""
        return float(1 / (1 + np.exp(-self.total)))


def verify(evidence: Evidence, config: VerificationConfig) -> Reason | None:
    """Check what the face shows at its final pose.

    Parameters
    ----------
    evidence : Evidence
        What it shows.
    config : VerificationConfig
        Thresholds.

    Returns
    -------
    Reason or None
        None where it is a pallet, else the sign that speaks most against it.
    """
    if evidence.probability >= config.min_rank:
        return None
    between, edges = evidence.parts
    return Reason.LOW_CONTRAST if between < edges else Reason.FEW_EDGES


def of_use(covariance: FloatArray, config: VerificationConfig) -> bool:
    """Tell whether a pose is known well enough to be of use.

    Parameters
    ----------
    covariance : (4, 4) array
        Of (x, y, z, yaw), in metres and radians.
    config : VerificationConfig
        Thresholds.

    Returns
    -------
    bool
        False where a standard deviation on the floor or of the yaw is too large.
    """
    place = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    turn = float(np.sqrt(covariance[3, 3]))
    return bool(place <= config.max_sigma and turn <= np.radians(config.max_yaw_sigma_deg))
