"""Measuring a straight edge in a plane view: gradient peaks to a fraction of a pixel, and a robust line through them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from palletloc.geometry import BoolArray, FloatArray
from palletloc.matching import Energy
from palletloc.plane import PlaneGrid

TUKEY = 4.685
"""Tukey's biweight constant: 95 % efficient on normal residuals."""


@dataclass(frozen=True, slots=True)
class EdgePeaks:
    """Where the gradient peaks along an edge."""

    along: FloatArray
    """(n,) positions along the edge from its middle, in metres."""
    offset: FloatArray
    """(n,) offsets of the peaks across the edge, in metres."""
    strength: FloatArray
    """(n,) gradient at the peaks, in gray levels per pixel; 0 where there is none."""


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
    """Median gradient of those peaks, in gray levels per pixel."""


def edge_peaks(
    gradient: Energy,
    grid: PlaneGrid,
    start: tuple[float, float],
    end: tuple[float, float],
    across: tuple[float, float],
    reach: float,
) -> EdgePeaks:
    """Find the strongest true local maximum of the gradient on each cut across an edge.

    The end of a slope is never a peak: a fit to it would only return the prediction.

    Parameters
    ----------
    gradient : (rows, columns) array
        Absolute gradient across the edge.
    grid : PlaneGrid
        Of the view.
    start, end : (float, float)
        The edge in plane coordinates, in metres.
    across : (float, float)
        Unit vector across the edge: the direction in which offsets count.
    reach : float
        How far from the edge to look, in metres.

    Returns
    -------
    EdgePeaks
        About one cut per pixel of the view.
    """
    ends = np.array([start, end])
    length = float(np.hypot(*(ends[1] - ends[0])))
    count = max(3, round(length / grid.resolution))
    steps = int(np.ceil(reach / grid.resolution)) + 1
    fraction = (np.arange(count) + 0.5) / count
    offsets = np.arange(-steps, steps + 1) * grid.resolution
    base = grid.pixels(ends[0] + fraction[:, None] * (ends[1] - ends[0]))
    step = np.array([across[0], -across[1]]) / grid.resolution
    cuts = (base[:, None] + offsets[None, :, None] * step).astype(np.float32)
    profile = cv2.remap(
        gradient, np.ascontiguousarray(cuts[..., 0]), np.ascontiguousarray(cuts[..., 1]), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    left, middle, right = profile[:, :-2], profile[:, 1:-1], profile[:, 2:]
    peak = np.where((middle > left) & (middle >= right), middle, 0.0)
    best = peak.argmax(axis=1)
    rows = np.arange(count)
    a, b, c = (part[rows, best].astype(np.float64) for part in (left, middle, right))
    curvature = np.minimum(a - 2 * b + c, -1e-9)
    shift = np.clip(0.5 * (a - c) / curvature, -0.5, 0.5)
    return EdgePeaks(
        (fraction - 0.5) * length,
        offsets[1 + best] + shift * grid.resolution,
        peak[rows, best].astype(np.float64),
    )


def fit_edge(
    peaks: EdgePeaks, pixel_across: float, pixel_along: float, min_strength: float = 0.0, slope_sigma: float = np.inf
) -> EdgeFit | None:
    """Fit a robust line (Tukey's biweight) through the peaks of an edge.

    Neighbouring cuts share pixels of the camera's image: the number of independent peaks is the length over the
    larger of one pixel and the residuals' own correlation length.

    Parameters
    ----------
    peaks : EdgePeaks
        From `edge_peaks`.
    pixel_across, pixel_along : float
        Size of a pixel of the camera's image across and along the edge, in metres.
    min_strength : float
        Weakest gradient that counts, in gray levels per pixel.
    slope_sigma : float
        How far the slope may be from zero (one standard deviation); keeps short edges from tilting.

    Returns
    -------
    EdgeFit or None
        None where fewer than three independent peaks agree.
    """
    seen = peaks.strength > min_strength
    if seen.sum() < 4:
        return None
    along, offset = peaks.along[seen], peaks.offset[seen]
    line, residual, scale = _robust_line(along, offset, 0.05 * pixel_across, slope_sigma)
    inlier = np.abs(residual) < 3 * scale
    correlation = _correlation_length(along, residual, inlier, pixel_along)
    independent = inlier.sum() * (peaks.along[1] - peaks.along[0]) / correlation
    if independent < 3:
        return None
    spread = along[inlier]
    center = float(spread.mean())
    variance = float(residual[inlier] @ residual[inlier]) / max(inlier.sum() - 2, 1) + (0.02 * pixel_across) ** 2
    slope_variance = variance / (independent * float(np.var(spread)) + 1e-12)
    slope_variance = 1.0 / (1.0 / slope_variance + slope_sigma**-2)
    return EdgeFit(
        offset=float(line[0]),
        slope=float(line[1]),
        sigma_offset=float(np.sqrt(variance / independent + slope_variance * center**2)),
        sigma_slope=float(np.sqrt(slope_variance)),
        coverage=float(inlier.sum() / len(peaks.along)),
        strength=float(np.median(peaks.strength[seen][inlier])),
    )


def _robust_line(
    along: FloatArray, offset: FloatArray, floor: float, slope_sigma: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the line, its residuals and their robust scale; starts from the median of pairwise slopes."""
    line = _theil_sen(along, offset, slope_sigma)
    design = np.stack([np.ones_like(along), along], axis=1)
    for _ in range(8):
        residual = offset - design @ line
        scale = max(1.4826 * float(np.median(np.abs(residual))), floor)
        weight = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0, None) ** 2
        normal = design.T @ (weight[:, None] * design)
        normal[1, 1] += (scale / slope_sigma) ** 2
        update = np.linalg.solve(normal + 1e-12 * np.eye(2), design.T @ (weight * offset))
        done = np.abs(update - line).max() < 1e-7
        line = update
        if done:
            break
    residual = offset - design @ line
    return line, residual, max(1.4826 * float(np.median(np.abs(residual))), floor)


def _theil_sen(along: FloatArray, offset: FloatArray, slope_sigma: float) -> FloatArray:
    half = len(along) // 2
    slopes = (offset[half : 2 * half] - offset[:half]) / (along[half : 2 * half] - along[:half])
    slope = float(np.clip(np.median(slopes), -2 * slope_sigma, 2 * slope_sigma))
    return np.array([np.median(offset - slope * along), slope])


def _correlation_length(along: FloatArray, residual: FloatArray, inlier: BoolArray, pixel: float) -> float:
    """Return the length over which residuals are alike, at least one pixel of the camera's image, in metres."""
    value = np.where(inlier, residual, 0.0)
    power = float(value @ value)
    step = float(along[-1] - along[0]) / max(len(along) - 1, 1)
    if power <= 0:
        return max(pixel, step)
    total, count = 1.0, min(len(value) // 3, 60)
    for lag in range(1, count):
        correlation = float(value[lag:] @ value[:-lag]) / power
        if correlation < 0.1:
            break
        total += 2 * correlation
    return max(pixel, total * step)
