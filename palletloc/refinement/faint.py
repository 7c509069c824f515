"""Edges that single cuts do not show: what the image changes across them, averaged along them.

In the dark, or where wood meets a floor of the same brightness, noise is stronger than an edge on every single cut.
The noise of neighbouring cuts is independent, the edge is not: an average along the line shows it. An average of
noise has a peak, too, and the same one on many cuts, so what it shows is tested against the scatter along the line.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palletloc.edge_fit import EdgeFit
from palletloc.geometry import FloatArray
from palletloc.refinement.profiles import Profiles, Samples

SIGNIFICANT = 4.0
"""How many of its standard deviations the mean change across an edge is from zero at least."""
ALIKE_PX = 2.0
"""How far noise is alike along a line, in pixels of the image: reading between pixels and compression spread it."""
EDGE_WIDTH_PX = 0.9
"""Width of an edge in the derivative of a smoothed profile (standard deviation), in pixels of the image."""


def significant(profiles: Profiles, signed: Samples, fits: list[EdgeFit | None]) -> list[EdgeFit | None]:
    """Keep the edges that stand out from the scatter along them, each as uncertain as they do.

    Parameters
    ----------
    profiles : Profiles
        Of the image across the lines.
    signed : (n, samples, channels) array
        Derivative on each cut.
    fits : list of EdgeFit or None
        Of each line.

    Returns
    -------
    list of EdgeFit or None
        With wider standard deviations; None where there may be nothing but noise.
    """
    return [
        _tested(profiles, signed, line, fit) if fit is not None else None for line, fit in enumerate(fits)
    ]


def _tested(profiles: Profiles, signed: Samples, line: int, fit: EdgeFit) -> EdgeFit | None:
    cuts = profiles.cuts
    mine = cuts.inner[cuts.line[cuts.inner] == line]
    places = (fit.offset + fit.slope * cuts.along[mine]) / profiles.reach[line]
    values = _read(signed[mine], profiles.offsets, places)
    mean = values.mean(axis=0)
    size = float(np.hypot.reduce(mean))
    if size <= 0:
        return None
    scatter = float((values @ (mean / size)).std())
    pixel = profiles.pixel[line]
    independent = max(len(mine) * min(1.0, float(cuts.spacing[line] / (ALIKE_PX * pixel[1]))), 2.0)
    stands_out = size * np.sqrt(independent) / max(scatter, 1e-6)
    if stands_out < SIGNIFICANT:
        return None
    error = EDGE_WIDTH_PX * float(pixel[0]) / stands_out
    return replace(fit, sigma_offset=float(np.hypot(fit.sigma_offset, error)))


def _read(signed: Samples, offsets: FloatArray, places: FloatArray) -> FloatArray:
    """Return (cuts, channels) the derivative at a place on each cut."""
    at = np.clip((places - offsets[0]) / (offsets[1] - offsets[0]), 0, len(offsets) - 1.001)
    low = at.astype(np.intp)
    part = (at - low)[:, None]
    row = np.arange(len(at))
    return np.asarray(signed[row, low] * (1 - part) + signed[row, low + 1] * part, dtype=np.float64)
