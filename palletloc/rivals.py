"""Other explanations of the image in a fit's place, each with how much likelier it is than the fit.

What is seen may also be another peak of the search, a pallet farther from a given start, one on no known level, the
same pallet one opening aside, or another model. `palletloc.fitting.decide` weighs them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import BetterModel, HeightPrior, Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import fit_face
from palletloc.shot import Shot
from palletloc.verification import NATS_PER_EDGE, WEAK_DOUBT

Measure = Callable[[Shot, Candidate, LocalizerConfig], Fit | Refusal]
"""Measures a candidate in a shot: a method."""

FAR_APART = 3.0
"""From how many standard deviations on a rival's pose is another pose: fewer are what a fit scatters by."""
WRONG_LEVEL = 0.01
"""How often a level that is given is wrong, before anything is seen."""
LEVEL_DOUBT = 1.0
"""Doubt from which on the level is asked whether the face agrees: a wrong one leaves about an edge or more aside."""
CLEAR = 1.0
"""How much more of the face must be seen one opening aside for it to be taken there, in nats."""
_NOWHERE = np.zeros(4)
"""Of a rival that widens nothing."""


@dataclass(frozen=True, slots=True)
class Rival:
    """Another explanation of the image in a fit's place."""

    nats: float
    """How much likelier it is than the fit, as a logarithm."""
    apart: FloatArray
    """(4,) how far its pose is from the fit's, (x, y, z, yaw) in metres and radians; zero where it widens nothing."""
    sigmas: float
    """How far it is apart in what tells them from each other, in standard deviations."""
    reason: Reason
    """Why the fit is refused where the rival wins."""
    instead: Fit | None = None
    """What takes the fit's place then; None where neither is to be believed."""
    better: BetterModel | None = None
    """The model that it is, where that is why it wins."""

    @property
    def wins(self) -> bool:
        """Whether it is likelier than the fit, and stands apart from it."""
        return self.nats > 0 and self.sigmas > FAR_APART


def other_starts(best: Fit | Refusal, attempts: Iterable[Fit | Refusal]) -> Iterator[Rival]:
    """Yield the fits from other starts of the search: less likely than the best one, but possible.

    Parameters
    ----------
    best : Fit or Refusal
        The likeliest of them.
    attempts : iterable of Fit or Refusal
        All of them.
    """
    for attempt in attempts:
        if attempt is not best and attempt.fit is not None and best.fit is not None:
            apart = attempt.fit.pose.minus(best.fit.pose)
            yield Rival(attempt.likelihood - best.likelihood, apart, 0.0, Reason.OVERLAP)


def own_start(best: Fit | Refusal, measure: Callable[[LevelPose], Fit | Refusal]) -> Iterator[Rival]:
    """Yield the fit from the candidate's start itself, on its level, where the search led to nothing.

    A faint face may score less than what stands around it, while the start was right.

    Parameters
    ----------
    best : Fit or Refusal
        What was measured from the peaks of the search.
    measure : callable
        Fits the face from a pose.
    """
    candidate = best.candidate
    if isinstance(best, Refusal) and candidate.height is not None:
        again = measure(replace(candidate.start, z=candidate.height.z))
        if isinstance(again, Fit):
            yield Rival(math.inf, _NOWHERE, math.inf, Reason.UNCERTAIN, again)


def wide_start(shot: Shot, best: Fit | Refusal, measure: Measure, config: LocalizerConfig) -> Iterator[Rival]:
    """Yield what is found in a wide search around a given start, where near it there is nothing beyond doubt.

    Parameters
    ----------
    shot : Shot
        The shot.
    best : Fit or Refusal
        What was measured near the start.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters; ``prior`` says how wide.
    """
    if isinstance(best, Refusal) and best.stage is Stage.START:
        return
    if best.fit is not None and best.fit.face is None:
        return  # a coarse pose says nothing of its doubt, given up or not
    if isinstance(best, Fit) and best.rank >= config.verification.certain:
        return
    prior = config.prior
    position = replace(config.position, nearer=prior.start_nearer, farther=prior.start_farther)
    search = replace(
        config.search, nearer=prior.start_nearer, farther=prior.start_farther, turn_deg=prior.start_turn_deg
    )
    yaw = replace(config.yaw, search=min(prior.start_nearer, prior.start_farther))
    again = measure(shot, best.candidate, replace(config, position=position, search=search, yaw=yaw))
    if isinstance(again, Fit):
        nats = _less_doubt(again, best) if isinstance(best, Fit) else math.inf
        yield Rival(nats, _NOWHERE, math.inf, Reason.UNCERTAIN, again)


def _less_doubt(fit: Fit, other: Fit) -> float:
    """Return how much less doubt the edges of one fit leave than those of another, in nats."""
    if fit.face is None or other.face is None:
        return -math.inf
    return NATS_PER_EDGE * (other.face.doubt - fit.face.doubt)


def any_height(shot: Shot, best: Fit, config: LocalizerConfig) -> Iterator[Rival]:
    """Yield the same face at any height, where a level is known and the edges leave doubt.

    A pose on a wrong level slides along its viewing ray until the level lines fit; the uprights then stand too far
    apart or too close.

    Parameters
    ----------
    shot : Shot
        The shot.
    best : Fit
        On its level.
    config : LocalizerConfig
        Parameters.
    """
    known, face = best.candidate.height, best.face
    if known is None or face is None or best.prior is None or face.doubt < LEVEL_DOUBT:
        return
    anywhere = replace(best.prior, height=HeightPrior(best.pose.z, config.prior.free_sigma), occluders=())
    free = fit_face(shot, best.pose, best.candidate.model, anywhere, config.face_fit, at_solution=True)
    if isinstance(free, Reason):
        return
    variance = float(free.covariance[2, 2]) * (1 + max(free.doubt - WEAK_DOUBT, 0.0) ** 2)
    off = abs(free.forklift_from_pallet.z - known.z) / float(np.sqrt(variance + known.sigma**2))
    # one more unknown fits always better: what it gains must outweigh how much it could have been anything
    chance = np.log(WRONG_LEVEL / (1 - WRONG_LEVEL) * np.sqrt(variance) / config.prior.free_sigma)
    odds = float(chance + 0.5 * off**2 + NATS_PER_EDGE * (face.doubt - free.doubt))
    if odds >= math.log(WRONG_LEVEL / (1 - WRONG_LEVEL)):  # else the face speaks rather for its level than against it
        yield Rival(odds, free.forklift_from_pallet.minus(best.pose), float(off), Reason.OFF_LEVEL)


def one_opening_aside(shot: Shot, best: Fit | Refusal, measure: Measure, config: LocalizerConfig) -> Iterator[Rival]:
    """Yield a doubtful fit's pallet one opening to its left and to its right, where as much of it is seen.

    Blocks and openings repeat, so a face fits there, too, but for its ends.

    Parameters
    ----------
    shot : Shot
        The shot.
    best : Fit or Refusal
        What was measured.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.
    """
    if isinstance(best, Refusal) or not _is_doubtful(best, config):
        return
    candidate = best.candidate
    for aside in _pitches(candidate.model):
        start = Candidate(candidate.model, _beside(best.pose, aside), candidate.height, yaws=candidate.yaws)
        rival = measure(shot, start, config)
        more, instead = _more_visible(rival, best), None
        if isinstance(rival, Fit) and more > CLEAR:
            instead = replace(rival, candidate=candidate)
        yield Rival(more, _NOWHERE, math.inf, Reason.OVERLAP, instead)


def _more_visible(rival: Fit | Refusal, best: Fit) -> float:
    """Return how much more of the face is seen with a rival's pose, in nats; -inf where that is the same pallet."""
    if rival.fit is None or rival.fit.evidence is None or best.evidence is None:
        return -math.inf
    apart = rival.fit.pose.minus(best.pose)
    far = math.hypot(apart[0], apart[1]) > best.candidate.model.width / 4
    return rival.fit.evidence.visible - best.evidence.visible if far else -math.inf


def _is_doubtful(fit: Fit, config: LocalizerConfig) -> bool:
    """Tell whether the ends of a face, which tell it from one an opening aside, may not have been seen."""
    if fit.face is None or fit.evidence is None:
        return False
    return fit.rank < config.verification.certain or fit.evidence.hidden > 0


def _pitches(model: PalletModel) -> tuple[float, ...]:
    """Return how far aside a face looks like itself, in metres to the right."""
    centers = np.array([opening.center for opening in model.openings])
    pitch = float(np.diff(centers).mean()) if len(centers) > 1 else model.width / 2
    return pitch, -pitch


def _beside(pose: LevelPose, right: float) -> LevelPose:
    return replace(pose, x=pose.x + float(np.sin(pose.yaw)) * right, y=pose.y - float(np.cos(pose.yaw)) * right)
