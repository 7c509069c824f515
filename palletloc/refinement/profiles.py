"""Profiles of the image across the lines of a face: where to cut, and what is seen there through any camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.edge_fit import EdgeFit, EdgePeaks, fit_edges
from palletloc.face import FaceEdge, FaceLine, face_lines
from palletloc.geometry import BoolArray, FloatArray
from palletloc.matching import channel_sum
from palletloc.pallet import PalletModel
from palletloc.shot import Shot

MOST_CUTS = 200
"""Most cuts across one stretch of a line."""
FEWEST_CUTS = 8
"""Fewest cuts across one stretch."""
PADS = 2
"""Cuts beyond each end of a stretch that only keep smoothing from reaching the next stretch."""
END_PIXELS = 1.0
"""How many pixels of the image at each end of an edge are left out."""
STEP_PX = 0.5
"""Samples of a profile lie at most this far apart, in pixels of the image."""
MARGIN = 2
"""Samples beyond the reach at each end of a profile: a peak needs neighbours."""
MOST_SAMPLES = 40
"""Most samples within the reach on each side."""
SMOOTHING_PX = 0.6
"""Standard deviation of the smoothing across a line, in pixels of the image."""

Samples = NDArray[np.float32]
"""Float32 array."""


@dataclass(frozen=True, slots=True)
class CutKind:
    """The cuts across all lines of one direction."""

    lines: slice
    """Which lines."""
    cuts: slice
    """Which cuts."""
    spacing: float
    """Mean distance between neighbouring cuts across a line, in metres."""


@dataclass(frozen=True, slots=True)
class FaceCuts:
    """Cuts across the lines of a face, stretch by stretch; its arrays are shared and read-only."""

    lines: tuple[FaceLine, ...]
    """The lines."""
    line: NDArray[np.intp]
    """(n,) the line that each cut crosses."""
    inner: NDArray[np.intp]
    """(m,) which cuts are none of the pads."""
    slot: NDArray[np.intp]
    """(m,) their places in the rows of all lines, one after the other, each of the same length."""
    points: FloatArray
    """(n, 2) where it crosses the drawn line: right and up on the face, in metres."""
    outward: FloatArray
    """(n, 2) unit vectors along each cut, out of the solid."""
    along: FloatArray
    """(n,) position along the line from its middle, in metres."""
    in_line: FloatArray
    """(lines, count) the same by line, without pads, filled up with zeros."""
    end: FloatArray
    """(n,) distance from the nearer end of its stretch, in metres; negative for pads."""
    shortest: FloatArray
    """(n,) a quarter of its stretch's length, in metres: no more is left out at an end."""
    level: BoolArray
    """(lines,) which lines are level: they come first."""
    length: FloatArray
    """(lines,) from the first to the last end of each line, in metres."""
    kinds: tuple[CutKind, ...]
    """The level lines, then the upright ones, as far as there are any."""

    @property
    def count(self) -> int:
        """Most cuts across one line."""
        return int(self.in_line.shape[1])

    def by_line(self, values: NDArray[Any], fill: float) -> FloatArray:
        """Return values of the cuts as (lines, count) without pads, filled up where a line has fewer."""
        padded = np.full(self.in_line.size, fill)
        padded[self.slot] = values[self.inner]
        return padded.reshape(self.in_line.shape)


@lru_cache(maxsize=256)
def face_cuts(model: PalletModel, level_spacing: float, upright_spacing: float, without_bottom: bool) -> FaceCuts:
    """Spread cuts evenly over the lines of a model's face.

    Parameters
    ----------
    model : PalletModel
        The pallet.
    level_spacing, upright_spacing : float
        About how far apart they are on level and on upright lines, in metres.
    without_bottom : bool
        Whether to leave out the lower edge.

    Returns
    -------
    FaceCuts
        Level lines first, each kind in the order of `face_lines`.
    """
    lines = [line for line in face_lines(model) if not (without_bottom and line.kind == "bottom")]
    lines.sort(key=lambda line: not line.whole.horizontal)
    return cuts_across(lines, level_spacing, upright_spacing)


def cuts_across(lines: Sequence[FaceLine], level_spacing: float, upright_spacing: float) -> FaceCuts:
    """Spread cuts evenly over lines.

    Parameters
    ----------
    lines : sequence of FaceLine
        The level ones first.
    level_spacing, upright_spacing : float
        About how far cuts are apart on either, in metres.

    Returns
    -------
    FaceCuts
        In the order of the lines.
    """
    edges = [edge for line in lines for edge in line.edges]
    numbers = np.repeat(np.arange(len(lines)), [len(line.edges) for line in lines])
    counts = np.array([_count(edge, level_spacing, upright_spacing) for edge in edges])
    lengths, starts = np.array([edge.length for edge in edges]), np.array([edge.start for edge in edges])
    stretch, place = _spread(counts)
    line, length, half = numbers[stretch], lengths[stretch], 0.5 / counts[stretch]
    level = np.array([line.whole.horizontal for line in lines])
    along = np.arange(len(stretch)), np.where(level[line], 0, 1)
    points = starts[stretch]
    points[along] += np.clip(place, half, 1 - half) * length
    from_middle = (points - np.array([line.whole.middle for line in lines])[line])[along]
    inner = np.flatnonzero((place > 0) & (place < 1))
    slot, in_line = _table(line[inner], from_middle[inner])
    outward, ends = np.array([line.whole.outward for line in lines])[line], np.minimum(place, 1 - place) * length
    whole = np.array([line.whole.length for line in lines])
    arrays = line, inner, slot, points, outward, from_middle, in_line, ends, length / 4, level, whole
    for array in arrays:
        array.flags.writeable = False
    spacing = np.bincount(numbers, weights=lengths) / np.bincount(line[inner])
    return FaceCuts(tuple(lines), *arrays, _kinds(level, line, spacing))


def _spread(counts: NDArray[np.intp]) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the stretch of each cut and its place there, in parts of its length; those of pads are outside it."""
    padded = counts + 2 * PADS
    stretch = np.repeat(np.arange(len(counts)), padded)
    which = np.arange(len(stretch)) - (np.cumsum(padded) - counts - PADS)[stretch]
    return stretch, (which + 0.5) / counts[stretch]


def _table(line: NDArray[np.intp], values: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the places of cuts without pads in a table that has a row for each line, and a table of their values."""
    totals = np.bincount(line)
    table = np.zeros((len(totals), int(totals.max())))
    slot = line * table.shape[1] + np.arange(len(line)) - (np.cumsum(totals) - totals)[line]
    table.flat[slot] = values
    return slot, table


def _kinds(level: BoolArray, line: NDArray[np.intp], spacing: FloatArray) -> tuple[CutKind, ...]:
    """Return the kinds of lines there are; the first lines are level."""
    lines, cuts = int(np.count_nonzero(level)), int(np.count_nonzero(level[line]))
    parts = (slice(lines), slice(cuts)), (slice(lines, None), slice(cuts, None))
    return tuple(CutKind(these, those, float(spacing[these].mean())) for these, those in parts if len(spacing[these]))


def _count(edge: FaceEdge, level_spacing: float, upright_spacing: float) -> int:
    """Return how many cuts cross a stretch, without the pads."""
    count = round(edge.length / (level_spacing if edge.horizontal else upright_spacing))
    return min(max(count, FEWEST_CUTS), MOST_CUTS)


@dataclass(frozen=True, slots=True)
class Profiles:
    """The image along each cut."""

    cuts: FaceCuts
    """The cuts."""
    sampled: Samples
    """(n, samples) or (n, samples, 3) gray levels or colours."""
    offsets: FloatArray
    """(samples,) positions along a cut, in parts of the reach."""
    valid: BoolArray
    """(n,) whether the camera sees the whole cut."""
    reach: FloatArray
    """(lines,) how far cuts go to each side, in metres."""
    pixel: FloatArray
    """(lines, 2) size of a pixel across and along each line, the same for all lines of a direction, in metres."""

    def gradient(self, along_px: float) -> Samples:
        """Return how fast the image changes across each line.

        Parameters
        ----------
        along_px : float
            Standard deviation of the smoothing along a line, in pixels of the image.

        Returns
        -------
        (n, samples) array
            Absolute derivative, the norm over the colour channels, in gray levels per sample.
        """
        gradient = np.empty(self.sampled.shape[:2], np.float32)
        step = float(self.offsets[1] - self.offsets[0])
        for kind in self.cuts.kinds:
            reach = self.reach[kind.lines]
            across, along = self.pixel[kind.lines][0].tolist()
            smooth = SMOOTHING_PX * across / (step * float(reach.sum()) / len(reach)), along_px * along / kind.spacing
            gradient[kind.cuts] = _derivative(self.sampled[kind.cuts], *smooth)
        return gradient


def cut_profiles(
    shot: Shot, camera_from_face: FloatArray, cuts: FaceCuts, shift: FloatArray, reach: FloatArray, pixel: FloatArray
) -> Profiles:
    """Sample the image along cuts.

    Parameters
    ----------
    shot : Shot
        The shot.
    camera_from_face : (4, 4) array
        The face's plane: x right, y up.
    cuts : FaceCuts
        Where to cut.
    shift : (lines,) array
        How far outward of each drawn line its cuts have their middle, in metres.
    reach : (lines,) array
        How far cuts go to each side, in metres.
    pixel : (lines, 2) array
        Size of a pixel across and along each line, in metres.

    Returns
    -------
    Profiles
        A row for each cut.
    """
    half = min(max(math.ceil(float((reach / pixel[:, 0]).max()) / STEP_PX), 4), MOST_SAMPLES)
    steps = np.arange(-half - MARGIN, half + MARGIN + 1) / half
    middle, away, valid = _places(shot, camera_from_face, cuts, shift, reach)
    first, way, parts = (part.astype(np.float32) for part in (middle, away, steps))
    columns, rows = (first[:, axis, None] + parts * way[:, axis, None] for axis in (0, 1))
    border = cv2.BORDER_REPLICATE if shot.camera.period_px is None else cv2.BORDER_WRAP
    sampled = np.asarray(cv2.remap(shot.image, columns, rows, cv2.INTER_LINEAR, borderMode=border), dtype=np.float32)
    return Profiles(cuts, sampled, steps, valid, reach, pixel)


def _places(
    shot: Shot, camera_from_face: FloatArray, cuts: FaceCuts, shift: FloatArray, reach: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the pixels of the cuts' middles, the way from there to the ends of their reach, and what is seen."""
    outwards = np.array([shift, shift + reach])[:, cuts.line, None]
    both = cuts.points + outwards * cuts.outward
    seen = shot.camera.project(both @ camera_from_face[:3, :2].T + camera_from_face[:3, 3])
    valid = seen.valid[0] & seen.valid[1]
    middle, away = seen.pixels[0], seen.pixels[1] - seen.pixels[0]
    period = shot.camera.period_px
    if period is not None and np.abs(away[:, 0]).max() > period / 2:
        away[:, 0] -= period * np.rint(away[:, 0] / period)
    if not valid.all():
        middle, away = (np.where(valid[:, None], part, 0.0) for part in (middle, away))
    return middle, away, valid


def _derivative(sampled: Samples, across: float, along: float) -> Samples:
    """Return the absolute derivative of smoothed profiles along their samples, the norm over the channels."""
    radius, width = max(1, round(3 * across)), max(1, round(2.5 * along))
    at = np.arange(-float(radius), radius + 1)
    slope = at * cv2.getGaussianKernel(len(at), max(across, 0.5))[:, 0]
    slope /= slope @ at
    smooth = cv2.getGaussianKernel(2 * width + 1, max(along, 0.2))
    change = cv2.sepFilter2D(sampled, cv2.CV_32F, slope, smooth, borderType=cv2.BORDER_REPLICATE)
    if change.ndim == 2:
        return np.asarray(np.abs(change), dtype=np.float32)
    return np.sqrt(channel_sum(np.asarray(change * change)))


def fit_profiles(profiles: Profiles, along_px: float) -> tuple[EdgePeaks, list[EdgeFit | None]]:
    """Find the peaks on each line and fit a robust line through them.

    Parameters
    ----------
    profiles : Profiles
        The image along the cuts.
    along_px : float
        Standard deviation of the smoothing along a line, in pixels of the image.

    Returns
    -------
    peaks : EdgePeaks
        The strongest on each cut.
    fits : list of EdgeFit or None
        Of each line; None where too few peaks make one.
    """
    cuts, across, along = profiles.cuts, profiles.pixel[:, 0], profiles.pixel[:, 1]
    # an upright edge stays upright: only level ones may tilt, by the yaw
    tilt = np.where(cuts.level, np.inf, 0.5 * across / cuts.length)
    peaks = _peaks(profiles, profiles.gradient(along_px))
    return peaks, fit_edges(peaks, across, along, profiles.reach, tilt)


def _peaks(profiles: Profiles, gradient: Samples) -> EdgePeaks:
    """Return the strongest true local maximum on each cut: the end of a slope would only return the prediction."""
    cuts, count = profiles.cuts, gradient.shape[1]
    # within the reach; the samples beyond it are only neighbours
    left, middle, right = (
        gradient[:, first : count - 2 * MARGIN + first] for first in (MARGIN - 1, MARGIN, MARGIN + 1)
    )
    offsets = profiles.offsets[MARGIN:-MARGIN]
    peaked = (middle > left) & (middle >= right)
    best = (middle * peaked).argmax(axis=1)
    at = np.arange(len(best)) * count + best + MARGIN - 1
    a, b, c = (gradient.ravel().take(at + which).astype(np.float64) for which in (0, 1, 2))
    shift = np.minimum(np.maximum(0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-9), -0.5), 0.5)
    offset = (offsets[best] + shift * (offsets[1] - offsets[0])) * profiles.reach[cuts.line]
    trimmed = cuts.end < np.minimum(END_PIXELS * profiles.pixel[cuts.line, 1], cuts.shortest)
    strength = np.where(trimmed, -1.0, b * peaked[np.arange(len(best)), best])
    return EdgePeaks(cuts.in_line, cuts.by_line(offset, 0.0), cuts.by_line(strength, -1.0))
