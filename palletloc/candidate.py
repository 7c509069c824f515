"""A place where a pallet may stand, and what a method makes of it: a fit, or a refusal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import BetterModel, HeightPrior, PalletMeasurement, Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import FaceEstimate, FacePrior
from palletloc.shot import Shot
from palletloc.verification import NATS_PER_EDGE, Evidence

_Step = TypeVar("_Step")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place where a pallet may stand."""

    model: PalletModel
    """What it may be."""
    start: LevelPose
    """``forklift_from_pallet`` where the steps begin."""
    height: HeightPrior | None = None
    """What is known of its height; None where nothing is."""
    score: float = 0.0
    """Agreement of image and drawing that it was found with, 0 to 1."""
    yaws: tuple[float, float] | None = None
    """Between which yaws it may stand, in radians; None where nothing says so."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A pose that a method measured in a candidate's place."""

    candidate: Candidate
    """Where it began."""
    pose: LevelPose
    """``forklift_from_pallet``."""
    covariance: FloatArray
    """(4, 4) of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    yaw_from: YawSource
    """What gave the yaw."""
    face: FaceEstimate | None = None
    """The fit of the face's edges; None where the method has none."""
    prior: FacePrior | None = None
    """What was known of the face before that."""
    evidence: Evidence | None = None
    """What the face shows at the pose; None where the method does not look."""
    steps: tuple[object, ...] = ()
    """Results of the steps on the way, in their order, for pictures: see `last_step`."""

    @property
    def fit(self) -> Fit:
        """The fit itself; a `Refusal` has here what had been measured."""
        return self

    @property
    def rank(self) -> float:
        """Its standing among candidates in one place, 0 to 1: the probability that it is a pallet, or the score."""
        return self.candidate.score if self.evidence is None else self.evidence.probability

    @property
    def likelihood(self) -> float:
        """How well it explains the image, in nats, to be compared with others; -inf where nothing tells."""
        if self.face is None or self.evidence is None:
            return -math.inf
        return self.evidence.total - NATS_PER_EDGE * self.face.doubt

    def measurement(self, shot: Shot) -> PalletMeasurement:
        """Return what it says of the pallet, with the shot's time and file."""
        return PalletMeasurement(
            shot.time, self.candidate.model.name, self.pose, self.covariance, self.rank, self.yaw_from, shot.file
        )


@dataclass(frozen=True, slots=True, eq=False)
class Refusal:
    """A candidate that was given up."""

    candidate: Candidate
    """The candidate."""
    stage: Stage
    """The step that gave it up."""
    reason: Reason
    """Why."""
    fit: Fit | None = None
    """What had been measured; None where it was given up before."""
    steps: tuple[object, ...] = ()
    """Results of the steps before, as in `Fit`."""
    better: BetterModel | None = None
    """The model that explains the image better; None where none does or the models are not the reason."""

    @property
    def rank(self) -> float:
        """Its standing among candidates in one place, 0 to 1."""
        return self.candidate.score if self.fit is None else self.fit.rank

    @property
    def likelihood(self) -> float:
        """How well what was measured explains the image, in nats; -inf where nothing was."""
        return -math.inf if self.fit is None else self.fit.likelihood


def steps_of(outcome: Fit | Refusal, kind: type[_Step]) -> list[_Step]:
    """Return the results of a kind among the steps of a fit or a refusal, in their order."""
    return [step for step in outcome.steps if isinstance(step, kind)]


def last_step(outcome: Fit | Refusal, kind: type[_Step]) -> _Step | None:
    """Return the last result of a kind among the steps of a fit or a refusal; None where there is none."""
    return next(reversed(steps_of(outcome, kind)), None)
