"""Every pallet of one shot: detect, measure each candidate, keep the best one in each place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palletloc.aliases import ask_beside
from palletloc.baselines import measure_as_in_paper, measure_jointly
from palletloc.cameras.protocol import CameraModel
from palletloc.candidate import Candidate, ShotView
from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.detection import Detection, detect
from palletloc.exclusivity import Measure, challenge, exclude_overlaps
from palletloc.exposure import brightened, points_about, shelf_points
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.measurement import HeightPrior, PalletMeasurement, Reason, Refusal, Stage
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.pipeline import RANGE_SLACK, measure_on_planes
from palletloc.projection import Projector
from palletloc.refined import measure_refined
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import ShelfView
from palletloc.verification import overlapping

METHODS: dict[Method, Measure] = {
    Method.REFINED: measure_refined,
    Method.HORIZONTAL_PLANE: measure_on_planes,
    Method.PAPER: measure_as_in_paper,
    Method.JOINT_SEARCH: measure_jointly,
}

UNVERIFIED = (Method.PAPER, Method.JOINT_SEARCH)
"""Methods without checks of the final pose: what they measure has to promise a pallet from the start."""
ABOVE = 0.3
"""How far above the highest level the light on the shelf is looked at, in metres."""

ON_FACE = np.array([(part, up) for up in (0.0, 1.0) for part in np.linspace(-0.5, 0.5, 9)])
"""(n, 2) places on a face of which a given pose must show one, in parts of its width and height."""


@dataclass(frozen=True, slots=True)
class Start:
    """A given place to begin from instead of a detection."""

    model: str
    """Name of the pallet model."""
    forklift_from_pallet: LevelPose
    """The pose."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Everything that was found in one shot, stage by stage."""

    time: float
    """When the shot was exposed, in seconds."""
    file: str
    """The shot's image, as the recording names it."""
    shelf_views: tuple[ShelfView, ...]
    """What was searched for pallets."""
    detections: tuple[Detection, ...]
    """Where pallets may stand."""
    candidates: tuple[Candidate, ...]
    """Each with the results of its steps, in the order in which they were given or found."""

    @property
    def measurements(self) -> list[PalletMeasurement]:
        """The poses of the pallets that passed every check."""
        found = (measurement_of(candidate, self.time, self.file) for candidate in self.candidates)
        return [one for one in found if one is not None]

    @property
    def refusals(self) -> list[Refusal]:
        """The candidates that were given up."""
        return [
            Refusal(self.time, candidate.model.name, *candidate.refusal, self.file)
            for candidate in self.candidates
            if candidate.refusal is not None
        ]


def measurement_of(candidate: Candidate, time: float, file: str) -> PalletMeasurement | None:
    """Return what a candidate measures; None where it was given up."""
    if candidate.refusal is not None or candidate.pose is None or candidate.covariance is None:
        return None
    return PalletMeasurement(
        time,
        candidate.model.name,
        candidate.pose,
        candidate.covariance,
        candidate.rank,
        candidate.yaw_from,
        file,
    )


class Localizer:
    """Finds the pose of every pallet in single shots of one camera.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    mounting : Mounting
        Where it sits on the forklift.
    models : iterable of PalletModel
        What to look for.
    method : Method
        How poses are measured.
    config : LocalizerConfig
        Parameters of every step.

    Notes
    -----
    Holds the camera's projection tables and no other state: shots may come in any order. Not to be shared by
    threads.
    """

    def __init__(
        self,
        camera: CameraModel,
        mounting: Mounting,
        models: Iterable[PalletModel],
        method: Method = Method.REFINED,
        config: LocalizerConfig | None = None,
    ) -> None:
        self.projector = Projector(camera)
        self.mounting = mounting
        self.models = {model.name: model for model in models}
        if not self.models:
            raise ValueError("a localizer needs at least one pallet model")
        self.method = method
        self.config = config or LocalizerConfig()

    def localize(self, image: Image, time: float, shelf: ShelfPlane, file: str = "") -> list[PalletMeasurement]:
        """Find every pallet on a shelf.

        Parameters
        ----------
        image : (height, width) or (height, width, 3) array
            The shot, gray or in blue-green-red order.
        time : float
            When it was exposed, in seconds.
        shelf : ShelfPlane
            Nominal front plane in the forklift frame at that time.
        file : str
            The image's name, for the results.

        Returns
        -------
        list of PalletMeasurement
            Empty where there is none.
        """
        return self.explain(image, time, shelf, file).measurements

    def explain(self, image: Image, time: float, shelf: ShelfPlane, file: str = "") -> Explanation:
        """Do what `localize` does and keep the result of every stage."""
        levels = shelf.levels or self.config.detection.heights
        heights = min(levels), max(levels) + ABOVE
        image = self._exposed(image, shelf_points(shelf, heights, self.config.detection.max_range))
        shot = self._shot(image)
        detections, views = detect(
            self.projector,
            image,
            shelf,
            self.mounting.forklift_from_camera,
            list(self.models.values()),
            self.config.detection,
        )
        candidates = [self._detected(detection) for detection in detections]
        for i, (candidate, detection) in enumerate(zip(candidates, detections, strict=True)):
            promise = detection.promise if self.method in UNVERIFIED else detection.hope
            self._measure(shot, candidate, promise, candidates[:i])
            self._challenge(shot, candidate)
        exclude_overlaps(candidates)
        for candidate in candidates:
            ask_beside(shot, candidate, METHODS[self.method], self.config)
        exclude_overlaps(candidates)
        return Explanation(time, file, tuple(views), tuple(detections), tuple(candidates))

    def localize_from(
        self, image: Image, time: float, starts: Sequence[Start], levels: Sequence[float] = (), file: str = ""
    ) -> list[PalletMeasurement | None]:
        """Measure pallets from given starts instead of detections.

        Parameters
        ----------
        image, time, file
            As for `localize`.
        starts : sequence of Start
            Where to begin.
        levels : sequence of float
            Known heights that loads stand on, in metres.

        Returns
        -------
        list of PalletMeasurement or None
            One for each start, in order; None where nothing was found.
        """
        explained = self.explain_from(image, time, starts, levels, file)
        return [measurement_of(candidate, time, file) for candidate in explained.candidates]

    def explain_from(
        self, image: Image, time: float, starts: Sequence[Start], levels: Sequence[float] = (), file: str = ""
    ) -> Explanation:
        """Do what `localize_from` does and keep the result of every stage."""
        candidates = [self._given(start, levels) for start in starts]
        usable = [candidate.start for candidate in candidates if candidate.refusal is None]
        if usable:
            image = self._exposed(image, points_about(usable))
        shot = self._shot(image)
        for candidate in candidates:
            if candidate.refusal is None:
                METHODS[self.method](shot, candidate, self.config)
        candidates = [self._looked_for_widely(shot, candidate) for candidate in candidates]
        for candidate in candidates:
            self._challenge(shot, candidate)
            ask_beside(shot, candidate, METHODS[self.method], self.config)
        return Explanation(time, file, (), (), tuple(candidates))

    def _looked_for_widely(self, shot: ShotView, candidate: Candidate) -> Candidate:
        """Return a candidate that was not found near its start beyond doubt, measured widely if that helps."""
        if candidate.refusal is not None and candidate.refusal[0] is Stage.START:
            return candidate
        certain = candidate.face is None or candidate.rank >= self.config.verification.certain
        if candidate.refusal is None and certain:
            return candidate
        prior, config = self.config.prior, self.config
        position = replace(config.position, nearer=prior.start_nearer, farther=prior.start_farther)
        search = replace(
            config.search, nearer=prior.start_nearer, farther=prior.start_farther, turn_deg=prior.start_turn_deg
        )
        yaw = replace(config.yaw, search=min(prior.start_nearer, prior.start_farther))
        wide = replace(config, position=position, search=search, yaw=yaw)
        again = Candidate(candidate.model, candidate.start, candidate.height, candidate.score)
        METHODS[self.method](shot, again, wide)
        if again.refusal is not None:
            return candidate
        return again if candidate.refusal is not None or _clearer(again, candidate) else candidate

    def _exposed(self, image: Image, points: FloatArray) -> Image:
        return brightened(image, self.projector.camera, self.mounting, points)

    def _shot(self, image: Image) -> ShotView:
        return ShotView(image, self.projector, self.mounting, self.mounting.to_camera)

    def _detected(self, detection: Detection) -> Candidate:
        height = None if detection.level is None else HeightPrior(detection.level, self.config.prior.level_sigma)
        return Candidate(detection.model, detection.forklift_from_pallet, height, detection.score, detection.yaws)

    def _given(self, start: Start, levels: Sequence[float]) -> Candidate:
        pose, prior = start.forklift_from_pallet, self.config.prior
        near = [level for level in levels if abs(level - pose.z) <= prior.level_reach]
        height = HeightPrior(min(near, key=lambda level: abs(level - pose.z)), prior.level_sigma) if near else None
        model = self.models.get(start.model)
        # an unknown model is refused before its face matters: any face will do
        face = model or replace(next(iter(self.models.values())), name=start.model)
        candidate = Candidate(face, pose, height)
        reason = Reason.UNKNOWN_MODEL if model is None else self._unusable(pose, model)
        if reason is not None:
            candidate.refuse(Stage.START, reason)
        return candidate

    def _unusable(self, pose: LevelPose, model: PalletModel) -> Reason | None:
        """Tell why nothing can be measured at a given pose, whatever the method."""
        if not np.isfinite(pose.as_array()).all():
            return Reason.NOT_FINITE
        place, center = (pose.x, pose.y, pose.z), self.mounting.center
        if math.dist(place, center) > RANGE_SLACK * self.config.detection.max_range:
            return Reason.OUT_OF_RANGE
        camera_from_pallet = self.mounting.camera_from_forklift @ pose.matrix()
        face = (ON_FACE * (model.width, model.height)) @ camera_from_pallet[:3, 1:3].T
        seen = self.projector.camera.project(face + camera_from_pallet[:3, 3])
        return None if seen.valid.any() else Reason.OUT_OF_VIEW

    def _challenge(self, shot: ShotView, candidate: Candidate) -> None:
        """Try every other model in the place of a pallet whose height only its size tells."""
        if self.method in UNVERIFIED:
            return  # as published they ask no such question
        others = [model for model in self.models.values() if model.name != candidate.model.name]
        challenge(shot, candidate, others, METHODS[self.method], self.config)

    def _measure(self, shot: ShotView, candidate: Candidate, promise: float, before: Sequence[Candidate]) -> None:
        """Measure a detection unless a pallet that is beyond doubt stands there."""
        certain = (one for one in before if one.refusal is None and one.rank >= self.config.verification.certain)
        for one in certain:
            if one.pose and overlapping(one.pose, one.model, candidate.start, candidate.model):
                return candidate.refuse(Stage.DETECTION, Reason.OVERLAP)
        if promise < self.config.verification.min_promise:
            return candidate.refuse(Stage.DETECTION, Reason.LOW_CONTRAST)
        return METHODS[self.method](shot, candidate, self.config)


def _clearer(one: Candidate, other: Candidate) -> bool:
    """Tell whether the edges of one candidate leave less doubt than another's."""
    return one.face is not None and (other.face is None or one.face.doubt < other.face.doubt)
