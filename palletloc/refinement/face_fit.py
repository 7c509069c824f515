"""Position and yaw from the edges of the front face, to a fraction of a pixel, with their covariance.

Each edge is measured across itself in the shot, where the last pose says it is. One linear least-squares fit
explains the offsets by a small motion of the face; what is known of height and yaw enters as observations, what
is not known of the mounting as parameters with their own sigmas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from palletloc.face import FaceEdge
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.depth_edges import add_depth_edges
from palletloc.refinement.edges import PIXEL_ERROR, EdgeReach, SeenFace, measure_face
from palletloc.refinement.level_lines import LevelYaw, yaw_from_level_lines
from palletloc.refinement.normal_equations import USED_WEIGHT, FaceEquations, FaceSolution
from palletloc.refinement.occlusion import Spans, hidden_part
from palletloc.shot import Shot

SMALL_PART = 0.5
"""Part of its standard deviation below which a motion that hardly moves the edges needs no further round."""
SAME, SAME_DEG = 0.012, 0.5
"""How far poses may be apart to be the same, along each axis in metres and in yaw in degrees."""
CUT_SPACING_PX = 1.5
"""About how far the cuts across an edge are apart, in pixels of the image."""
EDGES_PER_NAT = 0.5
"""How many missing edges each unit of evidence makes up for that edges behind the face give."""
FAINT_UPRIGHT = 0.2
"""Part of the level edges' gradient that upright ones have at least in a pallet: they belong to the same blocks."""
EXACT = 0.001
"""How far the edges of an exactly drawn pallet lie from their drawing, in metres: the tolerance of a model unless it
states another."""
HIDDEN_DOUBT = 0.5
"""How much an edge counts as missing that something seems to stand before."""


@dataclass(frozen=True, slots=True)
class FaceFitConfig:
    """How the edges of the face are measured and combined."""

    reach: float = 0.011
    """How far from its place an edge is looked for, in metres."""
    reach_px: float = 1.5
    """The same in pixels of the camera's image: the larger holds."""
    first_reach: float = 0.022
    """How far upright edges, which have no neighbours, are looked for at first, in metres."""
    iterations: int = 5
    """Most rounds of measuring, each where the last fit says."""
    min_coverage: float = 0.3
    """Least part of an edge that must be seen for it to count."""
    max_doubt: float = 1.5
    """Up to how many missing or contradicting edges a pose is taken without trying another."""
    hopeless_doubt: float = 8.0
    """From how many missing or contradicting edges on another round would not help."""
    min_edges: int = 5
    """Fewest edges that must be seen."""
    max_hidden: float = 0.5
    """Largest part of the face's width that something may stand before."""
    max_sigma: float = 0.5
    """Largest standard deviation of a position that is worth reporting, in metres."""
    small_motion: float = 0.003
    """Below which motion, in metres and radians, the face is not measured again; of its edges' images in any case."""
    slope_error_px: float = 0.15
    """How far each end of a level edge may lie off where its slope gives the yaw, in pixels of the camera's image."""


@dataclass(frozen=True, slots=True)
class YawPrior:
    """The yaw as the horizontal plane gives it."""

    sigma: float
    """Standard deviation of the start's yaw, in radians."""
    up: float
    """Height on the face of the edge that gave it, in metres."""


@dataclass(frozen=True, slots=True)
class FacePrior:
    """What is known of a face before its edges are measured."""

    height: HeightPrior
    """Of its lower edge."""
    yaw: YawPrior | None
    """What the horizontal plane says; None where the slopes of the face's level edges have to give the yaw."""
    yaw_spread: float
    """Standard deviation of the start's yaw where ``yaw`` is None, in radians."""
    occluders: Spans = ()
    """Stretches of the face that something is seen to stand before: (left, right), in metres."""


@dataclass(frozen=True, slots=True)
class FaceEstimate:
    """The pose of a face from its edges."""

    forklift_from_pallet: LevelPose
    """The pose."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    seen: SeenFace
    """The face as it was last measured, with its edges."""
    weights: FloatArray
    """(edges,) weight of each edge in the robust fit, 0 to 1."""
    chi2: float
    """Mean squared normalised residual of the edges that count."""
    doubt: float
    """How many edges are missing or contradict the others; below about 1 the pose is the right one."""
    level_yaw: LevelYaw | None = None
    """What the level lines alone say of the yaw: how far from the pose's, in radians."""
    repeated: bool = False
    """Whether an earlier fit came to the same pose."""
    behind: float = 0.0
    """Evidence for the pose from edges behind the face, as a logarithm; 0 where none agree."""
    nearness: float = 0.0
    """How much likelier the edges are where they were found than anywhere within reach, in nats: a model with loose
    tolerances, which fits whatever is there, gains little by it."""
    attainable: float = 0.0
    """What that would be if all visible edges lay exactly where a drawing has them."""

    @property
    def hidden(self) -> tuple[FaceEdge, ...]:
        """Edges that something stands before."""
        return self.seen.hidden_lines

    @property
    def coverage(self) -> float:
        """Part of the face's edges that lies where the pose says, 0 to 1: the mean of level and upright ones."""
        return _coverage(self.seen, self.weights)


def fit_face(
    shot: Shot,
    start: LevelPose,
    model: PalletModel,
    prior: FacePrior,
    config: FaceFitConfig,
    earlier: Sequence[LevelPose] = (),
    at_solution: bool = False,
) -> FaceEstimate | Reason:
    """Fit the pose of a face to its edges.

    Parameters
    ----------
    shot : Shot
        The shot.
    start : LevelPose
        ``forklift_from_pallet``, right to some millimetres where edges are.
    model : PalletModel
        The pallet.
    prior : FacePrior
        What is known of height and yaw, and of what stands before the face.
    config : FaceFitConfig
        Parameters.
    earlier : sequence of LevelPose
        Poses that other starts led to: the fit ends where it comes to one of them.
    at_solution : bool
        Whether the start is the result of another fit: then one round may do.

    Returns
    -------
    FaceEstimate or Reason
        `Reason.FEW_EDGES` or `Reason.HIDDEN` where too little of the face is seen, `Reason.OUT_OF_VIEW` or
        `Reason.BEHIND_FACE` where it cannot be.
    """
    pose = start
    rounds: list[_Round] = []
    for i in range(config.iterations):
        upright = max(config.reach, config.first_reach / 2**i)
        near = at_solution or i > 0
        reach = EdgeReach(config.reach, upright, config.reach_px, CUT_SPACING_PX, faint=near, settled=near)
        seen = _seen(shot, pose, model, reach, prior.occluders, config)
        if isinstance(seen, Reason):
            return seen
        system = FaceEquations(seen, pose, shot.mounting, model)
        system.add_height(prior.height.z - pose.z, prior.height.sigma)
        turned = wrap_angle(pose.yaw - start.yaw)
        if prior.yaw is not None:
            system.add_yaw(-turned, prior.yaw.sigma, prior.yaw.up)
        else:
            system.add_slopes(config.slope_error_px)
            system.add_turn(-turned, prior.yaw_spread)
        solution = system.solve()
        estimate = _estimate(seen, pose, solution)
        evidence = add_depth_edges(shot, model, system, solution, estimate.doubt) if near else 0.0
        if evidence > 0:
            solution = system.solve()
            estimate = _estimate(seen, pose, solution, evidence)
        found = _Round(estimate, solution)
        if float(solution.sigma[:3].max()) > config.max_sigma:
            return Reason.FEW_EDGES
        rounds.append(found)
        pose = found.estimate.forklift_from_pallet
        if found.estimate.doubt > config.hopeless_doubt:
            break
        there = any(_same_pose(pose, other) for other in earlier) or _settled(solution, config)
        if there and (at_solution or upright <= config.reach):
            break
    else:  # it swings between poses, or still moves: that of least doubt is the best guess
        rounds[-2:] = sorted(rounds[-2:], key=lambda found: -found.estimate.doubt)
        rounds[-1] = _unsettled(rounds)
    return _finished(rounds[-1], earlier, config) if rounds else Reason.FEW_EDGES


class _Round(NamedTuple):
    """What one round of measuring gives."""

    estimate: FaceEstimate
    """The pose."""
    solution: FaceSolution
    """How the face moved to it."""


def _unsettled(rounds: Sequence[_Round]) -> _Round:
    """Return the last round of a fit that did not settle, as uncertain as it is far from the one before."""
    if len(rounds) < 2:
        return rounds[-1]
    before, last = (found.estimate.forklift_from_pallet for found in rounds[-2:])
    apart = last.minus(before)
    estimate = rounds[-1].estimate
    return rounds[-1]._replace(estimate=replace(estimate, covariance=estimate.covariance + np.outer(apart, apart)))


def _finished(found: _Round, earlier: Sequence[LevelPose], config: FaceFitConfig) -> FaceEstimate:
    """Return a fit's estimate with what the level lines say of its yaw, and whether it is a new pose."""
    estimate = found.estimate
    repeated = any(_same_pose(estimate.forklift_from_pallet, other) for other in earlier)
    lines = yaw_from_level_lines(estimate.seen, config.slope_error_px)
    if lines is not None:
        lines = replace(lines, turn=lines.turn - float(found.solution.motion[3]))
    return replace(estimate, level_yaw=lines, repeated=repeated)


def _settled(solution: FaceSolution, config: FaceFitConfig) -> bool:
    """Tell whether another round would find the same edges at the same places."""
    if np.abs(solution.shifts).max() > config.small_motion:
        return False
    return bool((np.abs(solution.motion) < np.maximum(config.small_motion, SMALL_PART * solution.sigma)).all())


def _same_pose(pose: LevelPose, other: LevelPose) -> bool:
    """Tell whether two fits lead to the same pose, as far as a fit is repeated exactly."""
    apart = np.abs(pose.minus(other))
    return bool(apart[:3].max() < SAME and apart[3] < np.radians(SAME_DEG))


def _seen(
    shot: Shot, pose: LevelPose, model: PalletModel, reach: EdgeReach, occluders: Spans, config: FaceFitConfig
) -> SeenFace | Reason:
    """Return the face at a pose with the edges that count."""
    seen = measure_face(shot, pose, model, reach, occluders)
    if isinstance(seen, Reason):
        return seen
    edges = tuple(edge for edge in seen.edges if edge.fit.coverage >= config.min_coverage)
    if len(edges) < len(seen.edges):
        seen = replace(seen, edges=edges)
    if len(seen.edges) < config.min_edges:
        return Reason.FEW_EDGES
    return Reason.HIDDEN if seen.hidden_part > config.max_hidden else seen


def _estimate(seen: SeenFace, pose: LevelPose, solution: FaceSolution, behind: float = 0.0) -> FaceEstimate:
    right, up, depth, turn = (float(value) for value in solution.motion)
    cos, sin = float(np.cos(pose.yaw)), float(np.sin(pose.yaw))
    moved = LevelPose(
        pose.x + cos * depth + sin * right,
        pose.y + sin * depth - cos * right,
        pose.z + up,
        wrap_angle(pose.yaw + turn),
    )
    forklift_from_face = np.array([[sin, 0, cos, 0], [-cos, 0, sin, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    covariance = forklift_from_face @ solution.covariance @ forklift_from_face.T
    doubt = _doubt(seen, solution, behind)
    near, attainable = _nearness(seen, solution)
    return FaceEstimate(
        moved,
        covariance,
        seen,
        solution.weights,
        solution.chi2,
        doubt,
        behind=behind,
        nearness=near,
        attainable=attainable,
    )


def _nearness(seen: SeenFace, solution: FaceSolution) -> tuple[float, float]:
    """Return how much likelier the edges are where they were found than anywhere within reach, in nats, and the most.

    The density of a Gaussian that ends at the reach, against an even one.
    """
    numbers = [(edge.evidence_weight, edge.reach, edge.sigma, edge.shift.sigma, edge.pixel) for edge in seen.edges]
    says, reach, measured, own, pixel = np.array(numbers).T
    found = _gain(reach / np.hypot(measured, own)) - 0.5 * solution.residuals**2
    most = _gain(reach / np.sqrt(EXACT**2 + (PIXEL_ERROR * pixel) ** 2 + own**2))
    return float((says * solution.weights) @ found), float(
        seen.expected * (says @ most) / max(float(says.sum()), 1e-9)
    )


def _gain(parts: FloatArray) -> FloatArray:
    """Return the gain of an edge exactly in its place, in nats, by its reach in standard deviations."""
    return np.asarray(np.log(parts * math.sqrt(2.0 / math.pi) / erf(parts / math.sqrt(2.0))))


def _doubt(seen: SeenFace, solution: FaceSolution, behind: float) -> float:
    """Return how many edges are missing or contradict the others, with what the edges behind the face make up for."""
    says = np.array([edge.evidence_weight for edge in seen.edges])
    missing = seen.expected - float(says @ solution.weights) + HIDDEN_DOUBT * len(seen.hidden_lines)
    return max(missing + max(solution.chi2 - 1.0, 0.0) - EDGES_PER_NAT * behind, 0.0)


def _coverage(seen: SeenFace, weights: FloatArray) -> float:
    """Return the part of the edges that is seen: upright ones count as much as level ones, which are longer.

    A line on the floor covers every level edge of a face and no upright one; what is found of those is far fainter.
    """
    level, upright = (
        median([edge.fit.strength for edge in seen.edges if edge.edge.horizontal is direction] or [0.0])
        for direction in (True, False)
    )
    parts = []
    for direction in (True, False) if upright > FAINT_UPRIGHT * level else (True,):
        visible = sum(
            seen.evidence_weight(line) * line.length * (1 - hidden_part(line.start[0], line.end[0], seen.hidden))
            for line in seen.lines
            if line.horizontal is direction
        )
        covered = sum(
            edge.evidence_weight * edge.edge.length * edge.fit.coverage
            for edge, weight in zip(seen.edges, weights, strict=True)
            if edge.edge.horizontal is direction and weight > USED_WEIGHT
        )
        parts.append(min(1.0, covered / visible) if visible > 0 else 0.0)
    return float(sum(parts) / 2)
