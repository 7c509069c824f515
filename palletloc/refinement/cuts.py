"""Where the image is cut across the lines of a face to find its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palletloc.face import FaceLine, face_lines
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
    names = ("line", "inner", "slot", "points", "along", "end", "least")
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    most, total, apart = 0, 0, []
    for number, line in enumerate(lines):
        spacing = level_spacing if line.whole.horizontal else upright_spacing
        middle, first = np.array(line.whole.middle), 0
        direction = np.array([1.0, 0.0]) if line.whole.horizontal else np.array([0.0, 1.0])
        for edge in line.edges:
            count = int(np.clip(round(edge.length / spacing), FEWEST_CUTS, MOST_CUTS))
            place = (np.arange(-PADS, count + PADS) + 0.5) / count
            at = np.clip(place, 0.5 / count, 1 - 0.5 / count)
            points = np.array(edge.start) + (at * edge.length)[:, None] * direction
            parts["line"].append(np.full(len(at), number))
            parts["inner"].append(total + PADS + np.arange(count))
            parts["slot"].append(first + np.arange(count))
            parts["points"].append(points)
            parts["along"].append((points - middle) @ direction)
            parts["end"].append(np.minimum(place, 1 - place) * edge.length)
            parts["least"].append(np.full(len(at), edge.length / 4))
            first, total = first + count, total + len(at)
        most = max(most, first)
        apart.append(sum(edge.length for edge in line.edges) / first)
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    outward = np.array([line.whole.outward for line in lines])
    level = np.array([line.whole.horizontal for line in lines])
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
        most,
        level,
        int(np.count_nonzero(level[joined["line"]])),
        np.array(apart),
    )
