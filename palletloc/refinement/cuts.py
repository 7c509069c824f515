"""Where the image is cut across the lines of a face to find its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palletloc.face import FaceEdge, FaceLine, face_lines
from palletloc.geometry import BoolArray, FloatArray
from palletloc.pallet import PalletModel

MOST_CUTS = 200
"""Most cuts across one stretch of a line."""
FEWEST_CUTS = 8
"""Fewest cuts across one stretch."""
PADS = 2
"""Cuts beyond each end of a stretch that only keep smoothing from reaching the next stretch."""


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
    lines = [one for one in face_lines(model) if not (without_bottom and one.kind == "bottom")]
    lines.sort(key=lambda one: not one.whole.horizontal)
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
    level = np.array([one.whole.horizontal for one in lines])
    along = np.arange(len(stretch)), np.where(level[line], 0, 1)
    points = starts[stretch]
    points[along] += np.clip(place, half, 1 - half) * length
    from_middle = (points - np.array([one.whole.middle for one in lines])[line])[along]
    inner = np.flatnonzero((place > 0) & (place < 1))
    slot, in_line = _table(line[inner], from_middle[inner])
    outward, ends = np.array([one.whole.outward for one in lines])[line], np.minimum(place, 1 - place) * length
    whole = np.array([one.whole.length for one in lines])
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
