"""The same pallet one opening aside: blocks and openings repeat, so a face fits there, too, but for its ends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.exclusivity import Measure
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason, Stage
from palletloc.pallet import PalletModel

CLEAR = 1.0
"""How much more of the face must be seen beside a candidate for it to be taken there, in nats."""


def ask_beside(shot: ShotView, candidate: Candidate, measure: Measure, config: LocalizerConfig) -> None:
    """Measure a doubtful candidate's pallet one opening to its left and to its right, too.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        With a pose; where more of the face is seen beside it, that pose is taken, or none where that one fails its
        checks or is hardly better.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.
    """
    if candidate.refusal is not None or candidate.pose is None or not _is_doubtful(candidate, config):
        return
    found = candidate.pose
    for aside in _pitches(candidate.model):
        rival = Candidate(candidate.model, _beside(found, aside), candidate.height, yaws=candidate.yaws)
        measure(shot, rival, config)
        more = _more_shown(rival, candidate)
        if more < 0:
            continue
        if rival.refusal is None and more > CLEAR:
            candidate.take(rival)
        else:
            candidate.refuse(Stage.VERIFICATION, Reason.OVERLAP)
        return


def _more_shown(one: Candidate, other: Candidate) -> float:
    """Return how much more of the face is seen with one candidate's pose than with another's, in nats."""
    if one.verification is None or other.verification is None or one.pose is None or other.pose is None:
        return -math.inf
    apart = math.hypot(one.pose.x - other.pose.x, one.pose.y - other.pose.y)
    return one.verification.shown - other.verification.shown if apart > other.model.width / 4 else -math.inf


def _is_doubtful(candidate: Candidate, config: LocalizerConfig) -> bool:
    """Tell whether the ends of a face, which tell it from one an opening aside, may not have been seen."""
    if candidate.face is None or candidate.verification is None:
        return False
    return candidate.rank < config.verification.certain or candidate.verification.signs.hidden > 0


def _pitches(model: PalletModel) -> tuple[float, ...]:
    """Return how far aside a face looks like itself, in metres to the right."""
    centers = np.array([opening.center for opening in model.openings])
    pitch = float(np.diff(centers).mean()) if len(centers) > 1 else model.width / 2
    return pitch, -pitch


def _beside(pose: LevelPose, right: float) -> LevelPose:
    return replace(pose, x=pose.x + float(np.sin(pose.yaw)) * right, y=pose.y - float(np.cos(pose.yaw)) * right)
