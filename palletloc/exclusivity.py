"""One pallet in one place: candidates that stand in each other, and models that look alike at another distance.

Where nothing is known of the height, only the size of a face tells how far away it is: a smaller model nearer to
the camera covers the same part of the image as a larger one behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose, wrap_angle
from palletloc.measurement import Reason, Stage
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.verification import NATS_PER_EDGE, of_use, overlapping

Measure = Callable[[ShotView, Candidate, LocalizerConfig], None]
"""Measures a candidate in a shot: leaves a pose or a refusal in it."""

FAR_APART = 3.0
"""From how many standard deviations on another model's pose is another pose."""


def exclude_overlaps(candidates: Iterable[Candidate]) -> None:
    """Refuse every candidate that stands in a better one: two pallets cannot overlap.

    What shows a pallet's blocks and openings but was given up for its edges or its height keeps its place, too:
    whatever else is found there is that pallet, seen wrongly.

    Parameters
    ----------
    candidates : iterable of Candidate
        All of one shot, after they were measured.
    """
    kept: list[tuple[Candidate, LevelPose]] = []
    for candidate in sorted(candidates, key=lambda one: -one.rank):
        if candidate.pose is None or not (candidate.refusal is None or _is_pallet(candidate)):
            continue
        if any(overlapping(pose, other.model, candidate.pose, candidate.model) for other, pose in kept):
            if candidate.refusal is None:
                candidate.refuse(Stage.VERIFICATION, Reason.OVERLAP)
        else:
            kept.append((candidate, candidate.pose))


def _is_pallet(candidate: Candidate) -> bool:
    lost = candidate.refusal is not None and candidate.refusal[1] is Reason.OVERLAP
    return candidate.verification is not None and candidate.verification.reason is None and not lost


def challenge(
    shot: ShotView, candidate: Candidate, others: Iterable[PalletModel], measure: Measure, config: LocalizerConfig
) -> None:
    """Try other models in a candidate's place in the image, where its height is unknown.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        After it was measured; is refused where another model explains the image better, and becomes less certain as
        far as another one is likely.
    others : iterable of PalletModel
        What else may stand there.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.
    """
    if candidate.height is not None or candidate.face is None:
        return
    for model in others:
        if candidate.refusal is not None or candidate.pose is None:
            return
        rival = Candidate(model, _seen_as(model, candidate, candidate.pose, shot.mounting), None)
        measure(shot, rival, config)
        compete(candidate, rival, config)


def compete(candidate: Candidate, rival: Candidate, config: LocalizerConfig) -> None:
    """Compare a candidate with a rival in the same place of the image, of which only one can be right.

    Parameters
    ----------
    candidate : Candidate
        With a pose; is refused where the rival explains the image better at another pose, and becomes less certain as
        far as the rival is likely.
    rival : Candidate
        Measured in the same shot.
    config : LocalizerConfig
        Parameters.
    """
    gain = rival.likelihood - candidate.likelihood
    # where an edge more speaks for the candidate there is no rival
    if rival.pose is None or candidate.pose is None or candidate.covariance is None or gain < -NATS_PER_EDGE:
        return
    apart = rival.pose.as_array() - candidate.pose.as_array()
    apart[3] = wrap_angle(apart[3])
    # what doubt has added to the covariance is no reason to believe in the worse of two
    fitted = candidate.covariance if candidate.face is None else candidate.face.covariance
    if gain > 0 and apart @ np.linalg.solve(fitted, apart) > FAR_APART**2:
        candidate.refuse(Stage.VERIFICATION, Reason.OVERLAP)
        return
    candidate.covariance = candidate.covariance + np.outer(apart, apart) / (1 + np.exp(-gain))
    if not of_use(candidate.covariance, config.verification):
        candidate.refuse(Stage.VERIFICATION, Reason.UNCERTAIN)


def _seen_as(model: PalletModel, candidate: Candidate, pose: LevelPose, mounting: Mounting) -> LevelPose:
    """Return where another model would appear as wide as a candidate, in the same direction."""
    place, center = np.array([pose.x, pose.y, pose.z]), mounting.center
    x, y, z = (center + model.width / candidate.model.width * (place - center)).tolist()
    return LevelPose(x, y, z, pose.yaw)
