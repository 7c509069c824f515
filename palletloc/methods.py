"""The default method, and the table of all: hypotheses scored in the image, then every edge of the best ones."""

from __future__ import annotations

from collections.abc import Sequence

from palletloc.baselines import measure_as_in_paper, measure_jointly, measure_on_planes
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.fitting import FitStart, decide, fit_from_starts
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.paper.horizontal_view import horizontal_source
from palletloc.refinement.patch import FacePatch
from palletloc.refinement.search import search
from palletloc.rivals import Measure, own_start
from palletloc.shot import Shot, out_of_sight


def measure_refined(shot: Shot, candidate: Candidate, config: LocalizerConfig) -> Fit | Refusal:
    """Measure a candidate: score hypotheses around its start, fit the face's edges from the best of them.

    Parameters
    ----------
    shot : Shot
        The shot.
    candidate : Candidate
        Where a pallet may stand.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Fit or Refusal
        With the `palletloc.refinement.search.Search` among its steps.
    """
    camera = shot.camera_in(candidate.start)
    hidden = out_of_sight(camera, config.farthest_start)
    if hidden is not None:
        return Refusal(candidate, Stage.START, hidden)
    found = search(shot, candidate.start, candidate.model, candidate.height, config.search, candidate.yaws)
    if isinstance(found, Reason):
        return Refusal(candidate, Stage.SEARCH, found)
    source = horizontal_source(candidate.model, camera, config.yaw)
    weak = source is YawSource.FACE or candidate.height is None

    def prepared(start: LevelPose) -> FitStart:
        return FitStart(start, source)

    def measured(starts: Sequence[tuple[LevelPose, FacePatch]]) -> Fit | Refusal:
        return fit_from_starts(shot, candidate, starts, prepared, weak, config, (found,))

    best = measured(found.starts)
    return decide(best, own_start(best, lambda start: measured([(start, found.patch)])), config)


METHODS: dict[Method, Measure] = {
    Method.REFINED: measure_refined,
    Method.HORIZONTAL_PLANE: measure_on_planes,
    Method.PAPER: measure_as_in_paper,
    Method.JOINT_SEARCH: measure_jointly,
}
"""How each method measures a candidate."""
