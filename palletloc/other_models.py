"""Other pallet models in a fit's place: those that are looked for, too, and those of the library that nobody named.

A model that is wrong by centimetres fits some of the edges and gives a confident pose centimetres aside.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.face import face_lines
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import BetterModel, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import EXACT, FaceEstimate
from palletloc.refinement.hypotheses import HypothesisGrid, score_hypotheses, score_pose
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.rivals import Measure, Rival
from palletloc.shot import Shot
from palletloc.verification import CLEAR_CONTRAST, NATS_PER_EDGE, Evidence

WRONG_MODEL = 0.05
"""How often the models that a recording names are not those that stand there, before anything is seen."""
DIFFERENT = 0.02
"""From what difference of its edges on another model is another pallet, in metres: less is what wear does."""
ENOUGH_NEAR = 0.6
"""Part of what the places of a fit's edges could say for its model that they say for the right one, as a rule."""
MOST_MODELS = 2
"""How many other models are measured in a fit's place: those that promise to explain most of the image."""
LESS_AGREEMENT = 0.15
"""How much less than the fit another model may agree with the image before it is fitted, where none of the fit's
edges lies near its drawing; nothing less where all do."""
MOST_TOTAL = Evidence(CLEAR_CONTRAST, coverage=1.0, score=1.0, doubt=0.0).total
"""The most that the signs of a pallet speak for it, in nats."""
ASIDE, PLACE_STEP = 0.6, 0.015
"""How far aside of a fit another model is tried: as far as one block may be taken for another; and in what steps, in
metres."""
RANGES, RANGE_STEP = 4, 0.03
"""How many places nearer and farther away it is tried at, and their distance in metres: in all what it costs to take
a level line for the next one."""
AROUND, PLACES_RESOLUTION = 0.12, 0.008
"""What a view to compare drawings in shows above and below the faces, and its metres per pixel."""


def other_models(
    shot: Shot, best: Fit | Refusal, models: Iterable[PalletModel], measure: Measure, config: LocalizerConfig
) -> Iterator[Rival]:
    """Yield other models in a fit's place in the image, where its height is unknown and only its size tells.

    Parameters
    ----------
    shot : Shot
        The shot.
    best : Fit or Refusal
        What was measured.
    models : iterable of PalletModel
        What else may stand there; the fit's own is no rival.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.
    """
    if isinstance(best, Refusal) or best.candidate.height is not None or best.face is None:
        return
    for model in models:
        if model.name == best.candidate.model.name:
            continue
        rival = measure(shot, Candidate(model, _as_wide(model, best, shot)), config)
        nats = rival.likelihood - best.likelihood
        if rival.fit is not None and nats >= -NATS_PER_EDGE:  # where an edge more speaks for the fit there is none
            apart = rival.fit.pose.minus(best.pose)
            yield Rival(nats, apart, _sigmas(apart, best.face), Reason.OVERLAP)


def unstated_models(
    shot: Shot, best: Fit | Refusal, library: Iterable[PalletModel], measure: Measure, config: LocalizerConfig
) -> Iterator[Rival]:
    """Yield models that nobody looked for in a fit's place, where its edges lie off their drawing.

    Parameters
    ----------
    shot : Shot
        The shot.
    best : Fit or Refusal
        What was measured.
    library : iterable of PalletModel
        What else there is; what hardly differs from the fit's own model is no rival.
    measure : callable
        Measures a candidate.
    config : LocalizerConfig
        Parameters.

    Notes
    -----
    Other models are tried where the edges lie so far off their drawing that they say clearly less than they could,
    or where several are missing. What is compared is how well all signs and the places of the edges explain
    the image, and how seldom a recording names the wrong models.
    """
    if isinstance(best, Refusal) or best.face is None or best.evidence is None:
        return
    if best.face.nearness >= ENOUGH_NEAR * best.face.attainable and best.face.doubt <= config.face_fit.max_doubt:
        return
    for model, start in _agreeing(shot, best, library, config):
        rival = measure(shot, Candidate(model, start, best.candidate.height), config)
        if isinstance(rival, Fit) and rival.face is not None:
            nats = _explained(rival) - _explained(best)
            chance = nats + math.log(WRONG_MODEL / (1 - WRONG_MODEL))
            apart, better = rival.pose.minus(best.pose), BetterModel(model.name, nats)
            # one whose own edges are in doubt makes the pose less certain, but is no reason to give it up
            sigmas = _sigmas(apart, best.face) if rival.face.doubt <= config.face_fit.max_doubt else 0.0
            if chance >= -NATS_PER_EDGE:
                yield Rival(chance, apart, sigmas, Reason.OTHER_MODEL, better=better)


def _explained(fit: Fit) -> float:
    """Return how well a fit explains the image, with how near its edges are to their drawing, in nats."""
    if fit.face is None or fit.evidence is None:
        return -math.inf
    return fit.evidence.total + fit.face.nearness


def _agreeing(
    shot: Shot, fit: Fit, library: Iterable[PalletModel], config: LocalizerConfig
) -> list[tuple[PalletModel, LevelPose]]:
    """Return the models whose drawing agrees best with the image about a fit's place, and where each does."""
    own, explained, reach = fit.candidate.model, _explained(fit), config.face_fit.reach
    models = [
        model
        for model in library
        if own.largest_difference(model) >= DIFFERENT and _most_explained(model, reach) > explained
    ]
    patch = _surroundings(shot, fit, models)
    if patch is None or fit.face is None:
        return []
    room = 1.0 - fit.face.nearness / max(fit.face.attainable, 1e-9)
    least, found = score_pose(patch, own, fit.pose) - LESS_AGREEMENT * room, []
    for model in models:
        scored = score_hypotheses(patch, model, _about(patch, model, fit), config.search).peaks[:1]
        found += [
            (peak.score * _most_explained(model, reach), model, peak.pose) for peak in scored if peak.score >= least
        ]
    found.sort(key=lambda place: -place[0])
    return [(model, pose) for _, model, pose in found[:MOST_MODELS]]


def _surroundings(shot: Shot, fit: Fit, models: Sequence[PalletModel]) -> FacePatch | None:
    """Return a view of a fit's plane that shows where other models may stand; None where there is none."""
    if not models:
        return None
    half = max(model.width for model in models) / 2 + ASIDE
    high = max(model.height for model in models) + AROUND
    patch = view_patch(shot, fit.pose, (-half, half, -AROUND, high), PLACES_RESOLUTION)
    return None if isinstance(patch, Reason) else patch


def _about(patch: FacePatch, model: PalletModel, fit: Fit) -> HypothesisGrid:
    """Return where another model may stand in a fit's place: blocks taken for others, and level lines for others.

    At an unknown height it appears as wide: it stands as much farther away as it is wider.
    """
    away = float(np.hypot(patch.plane_from_camera[0], patch.plane_from_camera[2]))
    free = fit.candidate.height is None
    as_wide = model.width / fit.candidate.model.width if free else 1.0
    ranges = as_wide + np.linspace(-1.0, 1.0, 2 * RANGES + 1) * (RANGES * RANGE_STEP / away)
    places = np.arange(-ASIDE, ASIDE + PLACE_STEP / 2, PLACE_STEP)
    return HypothesisGrid(np.zeros(1), ranges, places, np.zeros(1), free)


def _most_explained(model: PalletModel, reach: float) -> float:
    """Return how well a pallet of a model could explain an image, in nats: little where its dimensions are loose."""
    lines = len(face_lines(model))
    return MOST_TOTAL + lines * max(math.log(reach / max(model.tolerance, EXACT) * math.sqrt(2.0 / math.pi)), 0.0)


def _as_wide(model: PalletModel, fit: Fit, shot: Shot) -> LevelPose:
    """Return where another model would appear as wide as a fit's, in the same direction."""
    pose, center = fit.pose, shot.mounting.center
    place = np.array([pose.x, pose.y, pose.z])
    x, y, z = (center + model.width / fit.candidate.model.width * (place - center)).tolist()
    return LevelPose(x, y, z, pose.yaw)


def _sigmas(apart: FloatArray, face: FaceEstimate) -> float:
    """Return how far a rival is apart by what the edges alone leave uncertain.

    What doubt has added to the covariance is no reason to believe in the worse of two.
    """
    return math.sqrt(float(apart @ np.linalg.solve(face.covariance, apart)))
