"""A run over a recording against its truth: which estimate is of which pallet, what is missed and what is false."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.choices import NEAREST_LIMIT, TimeRule
from palletloc.errors import seconds
from palletloc.evaluation.pose_error import (
    EvaluationError,
    PalletEstimate,
    PlacedPallet,
    PoseError,
    TrueFace,
    Visibility,
    pose_error,
    true_faces,
)
from palletloc.evaluation.statistics import Proportion, clopper_pearson
from palletloc.evaluation.time_pairing import brackets, nearest_pairs, require_overlap
from palletloc.geometry import FloatArray, LevelPose
from palletloc.trajectory import Trajectory

PAIRING_DISTANCE = 0.5
"""Farthest that a measurement may lie from the pallet it belongs to, in metres."""
SAME_TIME = 1e-3
"""Within which a measurement's time is a shot's, in seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotMatch:
    """The estimates of one shot, each with its pallet, if any."""

    time: float
    """The shot's, in seconds."""
    errors: tuple[PoseError, ...]
    """Of the visible pallets that were found, in the order of the pallets."""
    beyond: tuple[PoseError, ...]
    """Of pallets that need not be found and were: neither counted nor held against the estimate."""
    missed: tuple[TrueFace, ...]
    """The visible pallets that were not found."""
    false: tuple[PalletEstimate, ...]
    """Estimates that belong to no pallet."""


def match_shot(
    time: float,
    estimates: Sequence[PalletEstimate],
    faces: Sequence[TrueFace],
    truth_covariances: Mapping[str, FloatArray] | None = None,
) -> ShotMatch:
    """Match the estimates of one shot with the true pallets, one to one, the closest pairs first.

    Parameters
    ----------
    time : float
        The shot's, in seconds.
    estimates : sequence of PalletEstimate
        Of that shot.
    faces : sequence of TrueFace
        Every true pallet, visible or not.
    truth_covariances : mapping of str to (4, 4) array, optional
        What the truth states of (x, y, z, yaw) in the forklift frame, for the pallets of which it does.

    Returns
    -------
    ShotMatch
        Every estimate and every visible pallet once. Nothing farther apart than `PAIRING_DISTANCE` is matched.
    """
    known = truth_covariances or {}
    pairs = _pairs(estimates, faces)
    found = {
        column: pose_error(time, estimates[row], faces[column], known.get(faces[column].id)) for row, column in pairs
    }
    used = {row for row, _ in pairs}
    in_order = [found[column] for column in sorted(found)]
    return ShotMatch(
        time,
        tuple(error for error in in_order if error.face.visible),
        tuple(error for error in in_order if not error.face.visible),
        tuple(face for column, face in enumerate(faces) if face.visible and column not in found),
        tuple(estimate for row, estimate in enumerate(estimates) if row not in used),
    )


def _pairs(estimates: Sequence[PalletEstimate], faces: Sequence[TrueFace]) -> list[tuple[int, int]]:
    """Return indices of an estimate and its face, closest first; neither is taken twice."""
    if not estimates or not faces:
        return []
    found = np.array([estimate.forklift_from_pallet.as_array()[:3] for estimate in estimates])
    true = np.array([face.forklift_from_pallet.as_array()[:3] for face in faces])
    distances = np.linalg.norm(found[:, None] - true, axis=2)
    pairs = []
    for _ in range(min(distances.shape)):
        row, column = (int(index) for index in np.unravel_index(int(distances.argmin()), distances.shape))
        if not distances[row, column] < PAIRING_DISTANCE:
            break
        pairs.append((row, column))
        distances[row, :] = distances[:, column] = np.inf
    return pairs


@dataclass(frozen=True, slots=True)
class DetectionRate:
    """How many pallets were found in some shots, and how many estimates were of none."""

    shots: int
    """Number of shots."""
    found: Proportion
    """Visible pallets that were found, over all shots; its value is the recall."""
    false: int
    """Estimates that belong to no pallet."""

    @property
    def recall(self) -> float:
        """Part of the visible pallets that was found, 0 to 1; NaN without one."""
        return self.found.value

    @property
    def false_per_shot(self) -> float:
        """False estimates per shot; NaN without a shot."""
        return self.false / self.shots if self.shots else float("nan")


def detection(shots: Iterable[ShotMatch], confidence: float = 0.95) -> DetectionRate:
    """Count what was found, missed and false.

    Parameters
    ----------
    shots : iterable of ShotMatch
        Of one or several recordings.
    confidence : float
        Of the recall's Clopper-Pearson interval.

    Returns
    -------
    DetectionRate
        Every view of a pallet counts once.
    """
    shots = list(shots)
    found = sum(len(shot.errors) for shot in shots)
    visible = found + sum(len(shot.missed) for shot in shots)
    return DetectionRate(
        len(shots), clopper_pearson(found, visible, confidence), sum(len(shot.false) for shot in shots)
    )


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
    visibility: Visibility = Visibility()
    """Which pallets have to be found."""
    name: str = "truth"
    """What messages call it."""


@dataclass(frozen=True, slots=True, eq=False)
class RunMatch:
    """A run against the truth."""

    shots: tuple[ShotMatch, ...]
    """The shots at which the truth is known, in the given order."""
    largest: float
    """Largest time from a shot to the nearest sample that was used, in seconds; 0 without a shot."""
    without_truth: tuple[float, ...]
    """Times of the shots that were left out, in seconds."""

    @property
    def errors(self) -> tuple[PoseError, ...]:
        """Of all shots, without pallets that need not be found."""
        return tuple(error for shot in self.shots for error in shot.errors)


def by_shot(times: Sequence[float], estimates: Iterable[PalletEstimate]) -> list[list[PalletEstimate]]:
    """Return the estimates of each shot; ``times`` are the shots', in seconds.

    Raises
    ------
    EvaluationError
        If an estimate's time is no shot's.
    """
    shots: list[list[PalletEstimate]] = [[] for _ in times]
    moments = np.array(times)
    for estimate in estimates:
        nearest = int(np.abs(moments - estimate.time).argmin())
        if abs(times[nearest] - estimate.time) > SAME_TIME:
            at, there = seconds(estimate.time, times[nearest])
            raise EvaluationError(f"a measurement at {at} s is of no shot; the nearest is {there} s")
        shots[nearest].append(estimate)
    return shots


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
        With the shots that were left out.

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
    return RunMatch(matched, largest, left_out)


def _true_poses(
    times: FloatArray, path: Trajectory, rule: TimeRule, limit: float
) -> tuple[dict[int, LevelPose], float]:
    """Return the forklift's pose by index of the shot, and the largest time to a sample."""
    if rule is TimeRule.NEAREST:
        pairs = nearest_pairs(times, path.times, limit)
        taken = path.times[pairs.second]
        used = {int(shot): path.pose_at(float(time)) for shot, time in zip(pairs.first, taken, strict=True)}
        return used, float(np.abs(pairs.differences).max(initial=0.0))
    between = brackets(times, path.times, limit)
    wanted = times[between.wanted]
    nearest = np.minimum(wanted - path.times[between.before], path.times[between.after] - wanted)
    used = {int(shot): path.pose_at(float(times[shot])) for shot in between.wanted}
    return used, float(nearest.max(initial=0.0))


def _matched(time: float, found: Sequence[PalletEstimate], pose: LevelPose, scene: TrueScene) -> ShotMatch:
    faces = true_faces(scene.pallets, scene.widths, pose, scene.forklift_from_camera, scene.visibility)
    return match_shot(time, found, faces)
