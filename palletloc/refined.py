"""Beyond the paper: hypotheses scored in the image, then every edge of the best ones to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import replace

from palletloc.attempts import keep_best
from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.pipeline import horizontal_plane_for, out_of_sight
from palletloc.refinement.search import search


def measure_refined(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
    """Measure a candidate: score hypotheses around its start, fit the face's edges from the best of them.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        Gets the results, or its refusal.
    config : LocalizerConfig
        Parameters.
    """
    hidden = out_of_sight(shot, candidate, config)
    if hidden is not None:
        return candidate.refuse(Stage.START, hidden)
    looked = search(
        shot.projector,
        shot.image,
        shot.mounting,
        candidate.start,
        candidate.model,
        candidate.height,
        config.search,
        candidate.yaws,
    )
    if isinstance(looked, Reason):
        return candidate.refuse(Stage.SEARCH, looked)
    candidate.search = looked
    source = horizontal_plane_for(shot, candidate, config)

    def ready(attempt: Candidate, start: LevelPose) -> LevelPose:
        attempt.yaw_from = source
        return start

    weak = source is YawSource.FACE or candidate.height is None
    keep_best(shot, candidate, looked.starts, ready, weak, config)
    if candidate.refusal is None or candidate.height is None:
        return None
    # a faint face may score less than what stands around it, while the start was right
    again = Candidate(candidate.model, candidate.start, candidate.height, candidate.score, search=looked)
    start = replace(candidate.start, z=candidate.height.z)
    keep_best(shot, again, [(start, looked.patch)], ready, weak, config)
    if again.refusal is None:
        candidate.take(again)
    return None
