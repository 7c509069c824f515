"""Measuring straight edges in a plane view: gradient peaks to a fraction of a pixel, and robust lines through them.

All edges of a face are measured together: every array has a row for each edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.fft import next_fast_len

from palletloc.geometry import BoolArray, FloatArray
from palletloc.matching import Energy
from palletloc.plane import PlaneGrid
from palletloc.robust import SIGMA_PER_MEDIAN, tukey_weights

CUTS = 64
"""Most cuts across an edge."""
NOISE_FLOOR_PX = 0.05
"""Least scatter of peaks that is believed, in pixels of the camera's image."""
MAX_SCATTER = 0.45
"""Largest robust scatter of a line's peaks, in parts of the reach: even noise has 0.74."""
REWEIGHTINGS = 4
"""Rounds of weighting the peaks of a line."""
LEAST_CORRELATION = 0.1
"""Correlation of residuals below which they count as independent."""
MIN_INDEPENDENT = 3.0
"""Fewest independent peaks that make a line; one fewer where its slope is known."""
FREE_SLOPE = 1e3
"""Standard deviation of a slope of which nothing is known."""


@dataclass(frozen=True, slots=True)
class EdgePeaks:
    """Where the gradient peaks along each of several edges; n cuts are spread evenly over each edge."""

    along: FloatArray
    """(edges, n) positions of the cuts along the edge from its middle, in metres."""
    offset: FloatArray
    """(edges, n) offsets of the peaks across the edge, in metres."""
    strength: FloatArray
    """(edges, n) gradient at the peaks, in gray levels per pixel; 0 where there is none, -1 where no cut is."""


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """A line through the peaks of one edge: ``offset + slope * along``."""

    offset: float
    """At the edge's middle, in metres."""
    slope: float
    """Metres across per metre along."""
    sigma_offset: float
    """Standard deviation of the offset, in metres."""
    sigma_slope: float
    """Standard deviation of the slope."""
    coverage: float
    """Part of the edge whose peaks lie on the line, 0 to 1."""
    strength: float
    """Mean gradient of those peaks, in gray levels per pixel."""


def edge_peaks(
    gradient: Energy, grid: PlaneGrid, starts: FloatArray, ends: FloatArray, across: FloatArray, reach: FloatArray
) -> EdgePeaks:
    """Find the strongest true local maximum of the gradient on each cut across each edge.

    The end of a slope is never a peak: a fit to it would only return the prediction.

    Parameters
    ----------
    gradient : (rows, columns) array
        Absolute gradient across the edges.
    grid : PlaneGrid
        Of the view.
    starts, ends : (edges, 2) arrays
        The edges in plane coordinates, in metres.
    across : (2,) or (edges, 2) array
        Unit vectors across the edges: the direction in which offsets count.
    reach : (edges,) array
        How far from each edge to look, in metres.

    Returns
    -------
    EdgePeaks
        Cuts about a pixel of the view apart, at most `CUTS`.
    """
    length = np.hypot(*(ends - starts).T)
    count = int(np.clip(length.max() / grid.resolution, 4, CUTS))
    steps = int(np.ceil(reach.max() / grid.resolution)) + 1
    fraction = (np.arange(count) + 0.5) / count
    offsets = np.arange(-steps, steps + 1) * grid.resolution
    base = grid.pixels(starts[:, None] + fraction[:, None] * (ends - starts)[:, None])
    step = np.broadcast_to(across, starts.shape) * np.array([1.0, -1.0]) / grid.resolution
    cuts = (base[:, :, None] + offsets[:, None] * step[:, None, None]).astype(np.float32)
    count, steps = cuts.shape[1:3]
    flat = np.ascontiguousarray(cuts.reshape(-1, steps, 2))
    profile = np.asarray(
        cv2.remap(gradient, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    ).reshape(-1, count, steps)
    left, middle, right = profile[..., :-2], profile[..., 1:-1], profile[..., 2:]
    within = np.abs(offsets[1:-1]) <= reach[:, None, None] + 1e-9
    peak = np.where((middle > left) & (middle >= right) & within, middle, np.float32(0.0))
    best = peak.argmax(axis=2)[..., None]
    a, b, c = (np.take_along_axis(part, best, axis=2)[..., 0].astype(np.float64) for part in (left, middle, right))
    shift = np.clip(0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-9), -0.5, 0.5)
    return EdgePeaks(
        (fraction - 0.5) * length[:, None],
        offsets[1:-1][best[..., 0]] + shift * grid.resolution,
        np.take_along_axis(peak, best, axis=2)[..., 0].astype(np.float64),
    )


def join_peaks(peaks: EdgePeaks, middles: FloatArray, groups: Sequence[Sequence[int]]) -> EdgePeaks:
    """Join the peaks of edges that are stretches of one line.

    Parameters
    ----------
    peaks : EdgePeaks
        Of the single edges.
    middles : (edges,) array
        Where each edge's middle lies along its line, in metres.
    groups : sequence of sequences of int
        The edges of each line, in order along it.

    Returns
    -------
    EdgePeaks
        A row for each line, positions along it as the middles are given.
    """
    count = peaks.along.shape[1]
    size = max(len(group) for group in groups) * count
    along, offset, strength = (np.full((len(groups), size), fill) for fill in (0.0, 0.0, -1.0))
    for row, group in enumerate(groups):
        for k, edge in enumerate(group):
            part = np.s_[row, k * count : (k + 1) * count]
            along[part] = peaks.along[edge] + middles[edge]
            offset[part], strength[part] = peaks.offset[edge], peaks.strength[edge]
    return EdgePeaks(along, offset, strength)


def fit_edges(
    peaks: EdgePeaks,
    pixel_across: FloatArray,
    pixel_along: FloatArray,
    reach: FloatArray | float,
    slope_sigma: FloatArray | None = None,
) -> list[EdgeFit | None]:
    """Fit a robust line (Tukey's biweight) through the peaks of each edge.

    Neighbouring cuts share pixels of the camera's image: the number of independent peaks is the length over the
    larger of one pixel and the residuals' own correlation length.

    Parameters
    ----------
    peaks : EdgePeaks
        From `edge_peaks`.
    pixel_across, pixel_along : (edges,) arrays
        Size of a pixel of the camera's image across and along each edge, in metres.
    reach : (edges,) array or float
        How far peaks were looked for, in metres: where they fill it evenly there is noise and no line.
    slope_sigma : (edges,) array or None
        How far each slope may be from zero (one standard deviation); keeps short edges from tilting.

    Returns
    -------
    list of EdgeFit or None
        None for an edge of which fewer than three independent peaks agree, or whose peaks are noise.
    """
    limit = np.full(len(pixel_across), FREE_SLOPE) if slope_sigma is None else np.minimum(slope_sigma, FREE_SLOPE)
    lines = _robust_lines(peaks, NOISE_FLOOR_PX * pixel_across, limit)
    inlier = np.abs(lines.residual) < 3 * lines.scale[:, None]
    residual = np.where(inlier, lines.residual, 0.0)
    agreeing = np.count_nonzero(inlier, axis=1)
    count = np.maximum(agreeing, 1)
    step = peaks.along[:, 1] - peaks.along[:, 0]
    independent = count * step / np.maximum(_correlation_length(residual, step), pixel_along)
    center = np.einsum("ij,ij->i", peaks.along, inlier) / count
    spread = np.einsum("ij,ij->i", inlier, (peaks.along - center[:, None]) ** 2) / count
    variance = np.einsum("ij,ij->i", residual, residual) / np.maximum(count - 2, 1) + (0.02 * pixel_across) ** 2
    slope_variance = 1.0 / (independent * spread / variance + limit**-2)
    sigma_offset = np.sqrt(variance / np.maximum(independent, 1e-9) + slope_variance * center**2)
    strength = np.einsum("ij,ij->i", peaks.strength, inlier) / count
    coverage = agreeing / np.maximum(np.count_nonzero(peaks.strength >= 0, axis=1), 1)
    fewest = np.where(limit < FREE_SLOPE, MIN_INDEPENDENT - 1, MIN_INDEPENDENT)
    enough = (independent >= fewest) & (agreeing >= 4) & (lines.scale < MAX_SCATTER * reach)
    columns = (lines.offset, lines.slope, sigma_offset, np.sqrt(slope_variance), coverage, strength)
    rows = np.stack(columns, axis=1).tolist()
    return [EdgeFit(*row) if is_enough else None for row, is_enough in zip(rows, enough.tolist(), strict=True)]


class _Lines(NamedTuple):
    """Robust lines through the peaks of edges."""

    offset: FloatArray
    """(edges,) at the edges' middles."""
    slope: FloatArray
    """(edges,) metres across per metre along."""
    residual: FloatArray
    """(edges, n) offsets of the peaks from their line; infinite where there is no peak."""
    scale: FloatArray
    """(edges,) robust standard deviations of the residuals."""


def _robust_lines(peaks: EdgePeaks, floor: FloatArray, limit: FloatArray) -> _Lines:
    """Fit robust lines; starts from medians of values and pairwise slopes."""
    along, value, missing = peaks.along, peaks.offset, peaks.strength <= 0
    half = along.shape[1] // 2
    apart = along[:, half : 2 * half] - along[:, :half]
    unpaired = missing[:, half : 2 * half] | missing[:, :half] | (apart <= 0)
    pairs = (value[:, half : 2 * half] - value[:, :half]) / np.where(unpaired, 1.0, apart)
    slope = np.minimum(np.maximum(_Medians(unpaired).of(pairs), -2 * limit), 2 * limit)
    medians = _Medians(missing)
    offset = medians.of(value - slope[:, None] * along)
    # what the weights are multiplied with, for all sums at once
    sums = np.empty((*along.shape, 5))
    sums[..., 0] = counted = ~missing
    for k, product in enumerate((along, value, along * along, along * value), 1):
        sums[..., k] = product * counted
    for turn in range(REWEIGHTINGS + 1):
        residual = value - (offset[:, None] + slope[:, None] * along)
        scale = np.maximum(SIGMA_PER_MEDIAN * medians.of(np.abs(residual)), floor)
        if turn == REWEIGHTINGS:
            break
        weight = tukey_weights(residual, scale[:, None])
        total, a, v, aa, av = (weight[:, None] @ sums)[:, 0].T
        total = np.maximum(total, 1e-9)
        # the limit acts as an observation of a zero slope
        slope = (av - a * v / total) / (aa - a * a / total + (scale / limit) ** 2 + 1e-12)
        offset = (v - slope * a) / total
    residual[missing] = np.inf
    return _Lines(offset, slope, residual, scale)


class _Medians:
    """Medians of the rows of arrays without some places.

    Parameters
    ----------
    left_out : (rows, n) array
        Which places do not count.
    """

    def __init__(self, left_out: BoolArray) -> None:
        count = left_out.shape[1] - np.count_nonzero(left_out, axis=1)
        self._left_out = left_out
        self._empty = np.flatnonzero(count == 0)
        self._at = np.arange(len(count)), np.maximum(count - 1, 0) // 2

    def of(self, values: FloatArray) -> FloatArray:
        """Return the median of each row, 0 where nothing counts; sorts the given array."""
        values[self._left_out] = np.inf
        values.sort(axis=1)
        found: FloatArray = values[self._at]
        found[self._empty] = 0.0
        return found


def _correlation_length(residual: FloatArray, step: FloatArray) -> FloatArray:
    """Return the length over which the residuals of each edge are alike, in metres."""
    count = residual.shape[1]
    lags = count // 3
    size = next_fast_len(count + lags, real=True)  # enough for so many lags not to meet the other end
    spectrum = np.fft.rfft(residual, size, axis=1)
    power = np.fft.irfft(spectrum * spectrum.conj(), size, axis=1)[:, :lags]
    correlation = power / (power[:, :1] + 1e-18)
    alike = np.logical_and.accumulate(correlation[:, 1:] > LEAST_CORRELATION, axis=1)
    return np.asarray((1 + 2 * np.einsum("ij,ij->i", correlation[:, 1:], alike)) * step)
