"""A run over a recording against its truth, shot by shot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.errors import PlacedPallet, Sight, by_shot, true_faces
from palletloc.evaluation.estimate import PalletEstimate
from palletloc.evaluation.estimate_error import EstimateError
from palletloc.evaluation.shot_match import ShotMatch, match_shot
from palletloc.evaluation.time_pairing import TimeRule, brackets, nearest_pairs, require_overlap
from palletloc.geometry import FloatArray, LevelPose
from palletloc.trajectory import Trajectory

NEAREST_LIMIT = 0.01
"""How far a nearest sample of the truth may lie from a shot, in seconds: at 1 m/s the forklift moves 1 cm."""

TruthCovariance = Callable[[float, str], FloatArray | None]
"""Gives the (4, 4) covariance of the true ``forklift_from_pallet`` for a time and a pallet's id, if there is one."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueScene:
    """What a run is compared with."""

    world_from_forklift: Trajectory
    """The forklift's true path."""
    pallets: Sequence[PlacedPallet]
    """Every pallet."""
    widths: Mapping[str, float]
    """Width of each model's front face, in metres."""
    forklift_from_camera: RigidTransform
    """The camera's mounting."""
    sight: Sight = Sight()
    """Which pallets have to be found."""
    covariance: TruthCovariance | None = None
    """What the truth says of its own uncertainty."""
    name: str = "truth"
    """What messages call it."""


@dataclass(frozen=True, slots=True, eq=False)
class RunMatch:
    """A run against the truth."""

    shots: tuple[ShotMatch, ...]
    """The shots at which the truth is known, in the given order."""
    rule: TimeRule
    """How the truth was taken for a shot's time."""
    limit: float
    """Largest time to the nearest sample, or between the samples on both sides, in seconds."""
    largest: float
    """Largest time from a shot to the nearest sample that was used, in seconds; 0 without a shot."""
    without_truth: tuple[float, ...]
    """Times of the shots that were left out, in seconds."""

    @property
    def errors(self) -> tuple[EstimateError, ...]:
        """Of all shots, without pallets that need not be found."""
        return tuple(error for shot in self.shots for error in shot.errors)


def match_run(
    times: Sequence[float],
    estimates: Iterable[PalletEstimate],
    scene: TrueScene,
    rule: TimeRule = TimeRule.NEAREST,
    limit: float = NEAREST_LIMIT,
) -> RunMatch:
    """Match the estimates of a recording with its truth.

    Parameters
    ----------
    times : sequence of float
        Of every shot, in seconds: one without an estimate counts, too.
    estimates : iterable of PalletEstimate
        In any order, at the times of shots.
    scene : TrueScene
        The truth.
    rule : TimeRule
        Whether the forklift is taken where the nearest sample of its path says, or between two samples.
    limit : float
        Largest time to the nearest sample, or between the two, in seconds. A shot beyond it is left out and
        listed.

    Returns
    -------
    RunMatch
        With the rule and the limit that were used.

    Raises
    ------
    EvaluationError
        If truth and shots have no time in common, an estimate is of no shot, or a model has no width.
    """
    moments = np.array(times, dtype=np.float64)
    require_overlap(moments, scene.world_from_forklift.times, ("shots", scene.name), slack=limit)
    shots = by_shot(times, estimates)
    true, largest = _true_poses(moments, scene.world_from_forklift, rule, limit)
    matched = tuple(_matched(times[index], shots[index], pose, scene) for index, pose in sorted(true.items()))
    left_out = tuple(time for index, time in enumerate(times) if index not in true)
    return RunMatch(matched, rule, limit, largest, left_out)


def _true_poses(
    times: FloatArray, path: Trajectory, rule: TimeRule, limit: float
) -> tuple[dict[int, LevelPose], float]:
    """Return the forklift's pose by index of the shot, and the largest time to a sample."""
    if rule is TimeRule.NEAREST:
        pairs = nearest_pairs(times, path.times, limit)
        taken = path.times[pairs.second]
        used = {int(shot): path.pose_at(float(time)) for shot, time in zip(pairs.first, taken, strict=True)}
        return used, float(np.abs(pairs.apart).max(initial=0.0))
    between = brackets(times, path.times, limit)
    wanted = times[between.wanted]
    away = np.minimum(wanted - path.times[between.before], path.times[between.after] - wanted)
    used = {int(shot): path.pose_at(float(times[shot])) for shot in between.wanted}
    return used, float(away.max(initial=0.0))


def _matched(time: float, found: Sequence[PalletEstimate], pose: LevelPose, scene: TrueScene) -> ShotMatch:
    faces = true_faces(scene.pallets, scene.widths, pose, scene.forklift_from_camera, scene.sight)
    stated = {} if scene.covariance is None else {face.id: scene.covariance(time, face.id) for face in faces}
    known = {name: covariance for name, covariance in stated.items() if covariance is not None}
    return match_shot(time, found, faces, known)
