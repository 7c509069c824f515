"""Every pallet of one shot: detect, measure each candidate, weigh its rivals, keep one pallet in each place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.detection import Detection, detect
from palletloc.fitting import decide
from palletloc.footprint import overlapping
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, PalletMeasurement, Reason, RefusedCandidate, Stage
from palletloc.methods import METHODS
from palletloc.other_models import other_models, unstated_models
from palletloc.overlap import exclude_overlaps
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.rivals import one_opening_aside, wide_start
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import ShelfView
from palletloc.shot import Shot, points_about, shelf_points

UNVERIFIED = (Method.PAPER, Method.JOINT_SEARCH)
"""Methods without checks of the final pose: what they measure has to promise a pallet from the start."""
ABOVE = 0.3
"""How far above the highest level the light on the shelf is looked at, in metres: what a pallet there reaches."""
ON_FACE = np.array([(part, up) for up in (0.0, 1.0) for part in np.linspace(-0.5, 0.5, 9)])
"""(n, 2) places on a face of which a given pose must show one, in parts of its width and height."""


@dataclass(frozen=True, slots=True)
class Start:
    """A given place to begin from instead of a detection."""

    model: str
    """Name of the pallet model."""
    forklift_from_pallet: LevelPose
    """The pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Everything that was found in one shot, stage by stage."""

    shot: Shot
    """The shot."""
    shelf_views: tuple[ShelfView, ...]
    """What was searched for pallets."""
    detections: tuple[Detection, ...]
    """Where pallets may stand."""
    outcomes: tuple[Fit | Refusal, ...]
    """What became of each candidate, in the order in which they were given or found."""

    @property
    def measurements(self) -> list[PalletMeasurement]:
        """The poses of the pallets that passed every check."""
        return [outcome.measurement(self.shot) for outcome in self.outcomes if isinstance(outcome, Fit)]

    @property
    def refusals(self) -> list[RefusedCandidate]:
        """The candidates that were given up."""
        return [
            RefusedCandidate(
                self.shot.time,
                refusal.candidate.model.name,
                refusal.stage,
                refusal.reason,
                self.shot.file,
                refusal.better,
            )
            for refusal in self.outcomes
            if isinstance(refusal, Refusal)
        ]


class Localizer:
    """Finds the pose of every pallet in single shots.

    Parameters
    ----------
    models : iterable of PalletModel
        What to look for.
    method : Method
        How poses are measured.
    config : LocalizerConfig
        Parameters of every step.
    library : iterable of PalletModel
        What may stand there instead; by default the models that come along.

    Notes
    -----
    Holds no state: shots may come in any order, and from any camera.
    """

    def __init__(
        self,
        models: Iterable[PalletModel],
        method: Method = Method.REFINED,
        config: LocalizerConfig | None = None,
        library: Iterable[PalletModel] | None = None,
    ) -> None:
        self.models = {model.name: model for model in models}
        if not self.models:
            raise ValueError("a localizer needs at least one pallet model")
        self.method = method
        self.config = config or LocalizerConfig()
        others = load_library().values() if library is None else library
        self.library = tuple(model for model in others if model.name not in self.models)

    def localize(self, shot: Shot, shelf: ShelfPlane) -> list[PalletMeasurement]:
        """Find every pallet on a shelf.

        Parameters
        ----------
        shot : Shot
            The shot.
        shelf : ShelfPlane
            Nominal front plane in the forklift frame at the shot's time.

        Returns
        -------
        list of PalletMeasurement
            Empty where there is none.

        Raises
        ------
        ShelfPlaneError
            If the camera is not before the shelf.
        """
        return self.explain(shot, shelf).measurements

    def explain(self, shot: Shot, shelf: ShelfPlane) -> Explanation:
        """Do what `localize` does and keep the result of every stage."""
        exposed = self._exposed_for(shot, shelf)
        detections, views = detect(exposed, shelf, list(self.models.values()), self.config.detection)
        fits = exclude_overlaps(self._fits(exposed, detections), self.config.verification)
        fits = exclude_overlaps([self._beside(exposed, fit) for fit in fits], self.config.verification)
        fits = [self._against_library(exposed, fit) for fit in fits]
        return Explanation(shot, tuple(views), tuple(detections), tuple(fits))

    def localize_from(
        self, shot: Shot, starts: Sequence[Start], levels: Sequence[float] = ()
    ) -> list[PalletMeasurement | None]:
        """Measure pallets from given starts instead of detections.

        Parameters
        ----------
        shot : Shot
            The shot.
        starts : sequence of Start
            Where to begin.
        levels : sequence of float
            Known heights that loads stand on, in metres.

        Returns
        -------
        list of PalletMeasurement or None
            One for each start, in order; None where nothing was found.
        """
        outcomes = self.explain_from(shot, starts, levels).outcomes
        return [outcome.measurement(shot) if isinstance(outcome, Fit) else None for outcome in outcomes]

    def explain_from(self, shot: Shot, starts: Sequence[Start], levels: Sequence[float] = ()) -> Explanation:
        """Do what `localize_from` does and keep the result of every stage."""
        given = [self._given(shot, start, levels) for start in starts]
        usable = [each.start for each in given if isinstance(each, Candidate)]
        exposed = shot.exposed_for(points_about(usable)) if usable else shot
        return Explanation(shot, (), (), tuple(self._from_start(exposed, each) for each in given))

    def _fits(self, shot: Shot, detections: Sequence[Detection]) -> list[Fit | Refusal]:
        """Measure detections, the best first, but none where a pallet that is beyond doubt stands."""
        fits: list[Fit | Refusal] = []
        for detection in detections:
            candidate = self._detected(detection)
            unlikely = self._unlikely(detection, candidate, fits)
            fits.append(Refusal(candidate, Stage.DETECTION, unlikely) if unlikely else self._fit(shot, candidate))
        return fits

    def _fit(self, shot: Shot, candidate: Candidate) -> Fit | Refusal:
        """Measure a candidate, and every other model in its place."""
        return self._against_models(shot, METHODS[self.method](shot, candidate, self.config))

    def _from_start(self, shot: Shot, given: Candidate | Refusal) -> Fit | Refusal:
        """Measure a given start: widely, where nothing beyond doubt is found near it."""
        if isinstance(given, Refusal):
            return given
        measure = METHODS[self.method]
        near = measure(shot, given, self.config)
        best = decide(near, wide_start(shot, near, measure, self.config), self.config)
        return self._against_library(shot, self._beside(shot, self._against_models(shot, best)))

    def _against_models(self, shot: Shot, best: Fit | Refusal) -> Fit | Refusal:
        """Weigh every other model; as published, the paper's methods ask no such question."""
        if self.method in UNVERIFIED:
            return best
        rivals = other_models(shot, best, self.models.values(), METHODS[self.method], self.config)
        return decide(best, rivals, self.config)

    def _beside(self, shot: Shot, best: Fit | Refusal) -> Fit | Refusal:
        """Weigh the same pallet one opening aside."""
        rivals = one_opening_aside(shot, best, METHODS[self.method], self.config)
        return decide(best, rivals, self.config)

    def _against_library(self, shot: Shot, best: Fit | Refusal) -> Fit | Refusal:
        """Weigh models that nobody looked for; as published, the paper's methods ask no such question."""
        if self.method in UNVERIFIED:
            return best
        rivals = unstated_models(shot, best, self.library, METHODS[self.method], self.config)
        return decide(best, rivals, self.config)

    def _exposed_for(self, shot: Shot, shelf: ShelfPlane) -> Shot:
        levels = shelf.levels or self.config.detection.heights
        heights = min(levels), max(levels) + ABOVE
        return shot.exposed_for(shelf_points(shelf, heights, self.config.detection.max_range))

    def _detected(self, detection: Detection) -> Candidate:
        height = None if detection.level is None else HeightPrior(detection.level, self.config.prior.level_sigma)
        return Candidate(detection.model, detection.forklift_from_pallet, height, detection.score, detection.yaws)

    def _unlikely(self, detection: Detection, candidate: Candidate, before: Sequence[Fit | Refusal]) -> Reason | None:
        """Tell why a detection is not worth measuring."""
        certain = [fit for fit in before if isinstance(fit, Fit) and fit.rank >= self.config.verification.certain]
        if any(overlapping(fit.pose, fit.candidate.model, candidate.start, candidate.model) for fit in certain):
            return Reason.OVERLAP
        promise = detection.promise if self.method in UNVERIFIED else detection.hope
        return Reason.LOW_CONTRAST if promise < self.config.verification.min_promise else None

    def _given(self, shot: Shot, start: Start, levels: Sequence[float]) -> Candidate | Refusal:
        """Return the candidate at a given start, or why nothing can be measured there."""
        pose, prior = start.forklift_from_pallet, self.config.prior
        near = [level for level in levels if abs(level - pose.z) <= prior.level_reach]
        height = HeightPrior(min(near, key=lambda level: abs(level - pose.z)), prior.level_sigma) if near else None
        model = self.models.get(start.model)
        # an unknown model is refused before its face matters: any face will do
        face = model or replace(next(iter(self.models.values())), name=start.model)
        candidate = Candidate(face, pose, height)
        reason = Reason.UNKNOWN_MODEL if model is None else self._unusable(shot, candidate)
        return candidate if reason is None else Refusal(candidate, Stage.START, reason)

    def _unusable(self, shot: Shot, candidate: Candidate) -> Reason | None:
        """Tell why nothing can be measured at a given pose, whatever the method."""
        pose, model = candidate.start, candidate.model
        if not np.isfinite(pose.as_array()).all():
            return Reason.NOT_FINITE
        if math.dist((pose.x, pose.y, pose.z), shot.mounting.center) > self.config.farthest_start:
            return Reason.OUT_OF_RANGE
        camera_from_pallet = shot.mounting.camera_from_forklift @ pose.matrix()
        face = (ON_FACE * (model.width, model.height)) @ camera_from_pallet[:3, 1:3].T
        seen = shot.camera.project(face + camera_from_pallet[:3, 3])
        return None if seen.valid.any() else Reason.OUT_OF_VIEW
