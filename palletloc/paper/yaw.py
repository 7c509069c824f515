"""Yaw from a horizontal plane (paper, section B).

Projected on the horizontal plane at its own height, a level edge of the front face is a straight line, and its
angle to the view's centre line is the error of the yaw that the plane was placed with. Any other level edge of the
face projects to a parallel line there, and a start that is wrong along the viewing ray changes no angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from palletloc.cameras.protocol import CameraModel
from palletloc.edge_fit import EdgeFit, edge_peaks, fit_edges, join_peaks
from palletloc.face import EdgeKind, FaceEdge, edge_shift, face_lines
from palletloc.geometry import LevelPose, wrap_angle
from palletloc.matching import Energy, gradient_across
from palletloc.measurement import Reason, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine, boundary_lines
from palletloc.paper.horizontal_view import MAX_DEPTH, BoundaryMethod, HorizontalView, YawConfig, line_up
from palletloc.projection import pixel_sizes
from palletloc.robust import consensus
from palletloc.shot import Shot

SMOOTHING_PIXELS = np.array([0.6, 1.5])
"""Smoothing before the gradient across and along an edge, in pixels of the camera's image."""
END_PIXELS = 1.5
"""How many pixels of the camera's image at each end of an edge are left out."""

UPWARD = np.array([0.0, 1.0])
"""Across a level edge, in a view's coordinates."""


@dataclass(frozen=True, slots=True)
class YawVote:
    """What one level line of the face says."""

    edge: FaceEdge
    """The line, from its first to its last end."""
    turn: float
    """Correction of the yaw, in radians."""
    sigma: float
    """Its standard deviation, in radians."""
    fit: EdgeFit
    """The line, in the view's coordinates."""
    used: bool
    """Whether it agrees with the others."""


@dataclass(frozen=True, slots=True)
class YawEstimate:
    """The yaw from one horizontal view."""

    yaw: float
    """Heading of the pallet in the forklift frame, in radians."""
    sigma: float
    """Standard deviation, in radians."""
    source: YawSource
    """The edge that weighs most."""
    votes: tuple[YawVote, ...]
    """What each edge says."""


class _Voter(NamedTuple):
    """A level line of the face and where a horizontal view shows it."""

    edge: FaceEdge
    """The line, from its first to its last end."""
    stretches: tuple[tuple[tuple[float, float], tuple[float, float]], ...]
    """Ends of its stretches on the view's plane, without what lies beyond them, in metres."""
    pixel: tuple[float, float]
    """Sizes of the camera's pixels across and along it, in metres."""


def find_lines(seen: HorizontalView, config: YawConfig) -> list[BoundaryLine]:
    """Find the boundary lines of the face on a horizontal view, the likeliest first.

    Parameters
    ----------
    seen : HorizontalView
        From `view_horizontal`.
    config : YawConfig
        Parameters.

    Returns
    -------
    list of BoundaryLine
        Empty where there is none.
    """
    return boundary_lines(
        seen.view,
        two_region=config.boundary is BoundaryMethod.TWO_REGION,
        max_turn=float(np.radians(config.max_turn_deg)),
        step=float(np.radians(config.hough_step_deg)),
    )


def measure_line(
    shot: Shot, seen: HorizontalView, line: BoundaryLine, model: PalletModel, config: YawConfig
) -> EdgeFit | None:
    """Measure a line that the Hough transform found, to a fraction of a pixel.

    Parameters
    ----------
    shot : Shot
        The shot.
    seen : HorizontalView
        The view that the line was found on.
    line : BoundaryLine
        The line.
    model : PalletModel
        Gives the line's length.
    config : YawConfig
        Parameters.

    Returns
    -------
    EdgeFit or None
        Its ``slope`` is the tangent of the correction of the yaw; None where the line dissolves.
    """
    half = model.width / 2
    slope = float(np.tan(line.turn))
    measured = _gradient(shot.camera, seen, line.up)
    if measured is None:
        return None
    gradient, across, along = measured
    start, end = np.array([[-half, line.up - half * slope]]), np.array([[half, line.up + half * slope]])
    reach = max(2 * across, 3 * config.resolution)
    peaks = edge_peaks(gradient, seen.view.grid, start, end, UPWARD, np.array([reach]))
    fit = fit_edges(peaks, np.array([across]), np.array([along]), reach)[0]
    return None if fit is None else replace(fit, slope=fit.slope + slope)


def measure_yaw(
    shot: Shot, seen: HorizontalView, start: LevelPose, model: PalletModel, config: YawConfig
) -> YawEstimate | Reason:
    """Measure the yaw by sub-pixel lines along every level edge of the face: they vote.

    Parameters
    ----------
    shot : Shot
        The shot.
    seen : HorizontalView
        Placed with the start's yaw, which must be right to a degree or two.
    start : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    config : YawConfig
        Parameters.

    Returns
    -------
    YawEstimate or Reason
        `Reason.NO_LINE` where no edge is seen well enough.
    """
    measured = _gradient(shot.camera, seen, 0.0)
    voters = _voters(shot.camera, model, seen)
    if measured is None or not voters:
        return Reason.NO_LINE
    gradient, _, _ = measured
    lever = abs(float(seen.plane_from_camera[1] / seen.plane_from_camera[2]))
    ends = np.array([stretch for voter in voters for stretch in voter.stretches])
    reach = max(config.reach * lever, 2 * config.resolution)
    single = edge_peaks(gradient, seen.view.grid, ends[:, 0], ends[:, 1], UPWARD, np.full(len(ends), reach))
    count = np.cumsum([0, *(len(voter.stretches) for voter in voters)])
    groups = [range(first, last) for first, last in pairwise(count)]
    across, along = (np.array(sizes) for sizes in zip(*(voter.pixel for voter in voters), strict=True))
    fits = fit_edges(join_peaks(single, ends[:, :, 0].mean(axis=1), groups), across, along, reach)
    votes = []
    for voter, fit in zip(voters, fits, strict=True):
        if fit is None or fit.coverage < config.min_coverage:
            continue
        error = _end_error(voter.edge, seen.plane_from_camera[2] > 0, voter.pixel[1], config)
        tilt = np.sqrt(2.0) * error * lever / voter.edge.length
        sigma = float(np.hypot(fit.sigma_slope, tilt))
        votes.append(YawVote(voter.edge, float(np.arctan(fit.slope)), sigma, fit, True))
    if not votes:
        return Reason.NO_LINE
    return _poll(votes, start, config)


def _gradient(camera: CameraModel, seen: HorizontalView, up: float) -> tuple[Energy, float, float] | None:
    """Return the gradient across level lines, and the size of the camera's pixels across and along them.

    None where the camera does not see the lines' middle.
    """
    across, along = pixel_sizes(
        camera, seen.view.camera_from_plane, np.full((2, 2), [0.0, up]), np.array([[0.0, 1.0], [1.0, 0.0]])
    )
    if not np.isfinite([across, along]).all():
        return None
    sigma = SMOOTHING_PIXELS * np.array([across, along]) / seen.view.grid.resolution
    return (gradient_across(seen.view.image, True, float(sigma[0]), float(sigma[1])), float(across), float(along))


def _voters(lens: CameraModel, model: PalletModel, seen: HorizontalView) -> list[_Voter]:
    """Return the level lines that can be measured, and where the view shows them."""
    camera = seen.plane_from_camera
    face_from_camera = np.array([camera[0], camera[2] + seen.height, -camera[1]])
    lines = [line for line in face_lines(model) if line.whole.horizontal]
    if seen.source is YawSource.TOP:  # a beam may hide the lower edge and be taken for it
        lines = [line for line in lines if line.kind is not EdgeKind.BOTTOM]
    lines = [line for line in lines if abs(line_up(line.whole.middle[1] - seen.height, camera)) <= MAX_DEPTH]
    if not lines:
        return []
    heights = [
        line.whole.middle[1] + line.whole.outward[1] * edge_shift(line.whole, face_from_camera, model).mean
        for line in lines
    ]
    ups = np.array([line_up(height - seen.height, camera) for height in heights])
    middles = np.stack([np.zeros_like(ups), ups], axis=1)
    across = pixel_sizes(lens, seen.view.camera_from_plane, middles, UPWARD)
    along = pixel_sizes(lens, seen.view.camera_from_plane, middles, np.array([1.0, 0.0]))
    voters = []
    for line, height, up, wide, long in zip(lines, heights, ups, across, along, strict=True):
        scale = camera[2] / (camera[2] - height + seen.height)
        # a pixel that straddles an edge's end sees what lies beyond it
        trim = END_PIXELS * float(long)
        spans = [[camera[0] + (end[0] - camera[0]) * scale for end in (edge.start, edge.end)] for edge in line.edges]
        kept = [((left + trim, up), (right - trim, up)) for left, right in spans if right - left > 2 * trim + long]
        if kept:
            voters.append(_Voter(line.whole, tuple(kept), (float(wide), float(long))))
    return voters


def _end_error(edge: FaceEdge, from_above: bool, pixel_along: float, config: YawConfig) -> float:
    """Return how far each end of an edge may lie off on the face, in metres."""
    if edge.kind is EdgeKind.BOTTOM:
        return config.outline_error + config.outline_error_px * pixel_along
    error = config.opening_error_px * pixel_along
    if edge.kind is EdgeKind.TOP and from_above:
        error += config.load_error
    return max(error, config.outline_error)


def _poll(votes: Sequence[YawVote], start: LevelPose, config: YawConfig) -> YawEstimate:
    """Combine the votes: the largest group that agrees with one of them, weighted by their variances."""
    turn = np.array([vote.turn for vote in votes])
    sigma = np.array([vote.sigma for vote in votes])
    found = consensus(turn, sigma, config.agreement)
    heaviest = votes[int(np.where(found.group, sigma**-2, 0).argmax())]
    polled = tuple(
        YawVote(vote.edge, vote.turn, vote.sigma, vote.fit, bool(used))
        for vote, used in zip(votes, found.group, strict=True)
    )
    return YawEstimate(wrap_angle(start.yaw + found.mean), found.sigma, _source(heaviest.edge), polled)


def _source(edge: FaceEdge) -> YawSource:
    return YawSource(edge.kind.value)
