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
class FaceCuts:
    """Cuts across the lines of a face, stretch by stretch; its arrays are shared and read-only."""

    lines: tuple[FaceLine, ...]
    """The lines."""
    line: NDArray[np.intp]
    """(n,) the line that each cut crosses."""
    inner: NDArray[np.intp]
    """(m,) which cuts are none of the pads."""
    slot: NDArray[np.intp]
    """(m,) their places among the cuts of their line."""
    points: FloatArray
    """(n, 2) where it crosses the drawn line: right and up on the face, in metres."""
    outward: FloatArray
    """(lines, 2) unit vectors across each line, out of the solid."""
    along: FloatArray
    """(n,) position along the line from its middle, in metres."""
    end: FloatArray
    """(n,) distance from the nearer end of its stretch, in metres; negative for pads."""
    shortest: FloatArray
    """(n,) a quarter of its stretch's length, in metres: no more is left out at an end."""
    count: int
    """Most cuts across one line."""
    level: BoolArray
    """(lines,) which lines are level: they come first."""
    level_cuts: int
    """How many of the cuts, the first ones, are across level lines."""
    spacing: FloatArray
    """(lines,) distance between neighbouring cuts, in metres."""

    def by_line(self, values: NDArray[Any], fill: float) -> FloatArray:
        """Return values of the cuts as (lines, count) without pads, filled up where a line has fewer."""
        padded = np.full((len(self.lines), self.count), fill)
        padded[self.line[self.inner], self.slot] = values[self.inner]
        return padded


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
    # for each cut: its stretch, and which one of it, negative for the first pads
    stretch = np.repeat(np.arange(len(edges)), counts + 2 * PADS)
    everyone = np.arange(len(stretch))
    which = everyone - (np.cumsum(counts + 2 * PADS) - counts - PADS)[stretch]
    line, count, length = numbers[stretch], counts[stretch], lengths[stretch]
    place = (which + 0.5) / count
    outward = np.array([one.whole.outward for one in lines])
    level = np.array([one.whole.horizontal for one in lines])
    along = everyone, np.where(level[line], 0, 1)
    points = starts[stretch]
    points[along] += np.clip(place, 0.5 / count, 1 - 0.5 / count) * length
    inner = np.flatnonzero((which >= 0) & (which < count))
    totals = np.bincount(line[inner], minlength=len(lines))
    joined = {
        "line": line,
        "inner": inner,
        "slot": np.arange(len(inner)) - (np.cumsum(totals) - totals)[line[inner]],
        "points": points,
        "along": (points - np.array([one.whole.middle for one in lines])[line])[along],
        "end": np.minimum(place, 1 - place) * length,
        "least": length / 4,
    }
    for array in (*joined.values(), outward, level):
        array.flags.writeable = False
    return FaceCuts(
        tuple(lines),
        joined["line"],
        joined["inner"],
        joined["slot"],
        joined["points"],
        outward,
        joined["along"],
        joined["end"],
        joined["least"],
        int(totals.max()),
        level,
        int(np.count_nonzero(level[line])),
        np.bincount(numbers, weights=lengths) / totals,
    )


def _count(edge: FaceEdge, level_spacing: float, upright_spacing: float) -> int:
    """Return how many cuts cross a stretch, without the pads."""
    count = round(edge.length / (level_spacing if edge.horizontal else upright_spacing))
    return min(max(count, FEWEST_CUTS), MOST_CUTS)
