"""How single shots, tracks and surveyed stops look in the figures of an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from palletloc.drawing.canvas import GRID, INK, SERIES
from palletloc.evaluation.pose_error import PoseError
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import SHOTS_SOURCE, TRACKS_SOURCE
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class SourceStyle:
    """One source of estimates."""

    label: str
    """Its key."""
    color: str
    """As ``"#rrggbb"``."""
    mark: str
    """Of Matplotlib."""


STYLES = {
    SHOTS_SOURCE: SourceStyle("single shots", "#7c838d", "o"),
    TRACKS_SOURCE: SourceStyle("tracks", SERIES[0], "s"),
}
"""By the source's name."""
STOP_STYLE = SourceStyle("single shots at surveyed stops, against the survey", SERIES[1], "D")
"""Errors against a survey."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A component of the error as figures show it."""

    column: int
    """Its number in the offset of an error."""
    label: str
    """Its name."""
    unit: str
    """What it is shown in."""
    scale: float
    """How many of that are in a metre or radian."""

    def values(self, errors: Sequence[PoseError]) -> FloatArray:
        """Return the errors in the unit, (n,)."""
        return self.scale * np.array([one.offset[self.column] for one in errors])

    def sigmas(self, errors: Sequence[PoseError]) -> FloatArray:
        """Return the standard deviations in the unit, (n,)."""
        return self.scale * np.sqrt([one.covariance[self.column, self.column] for one in errors])

    def limit(self, requirement: Requirement) -> float:
        """Return the largest error that is allowed, in the unit."""
        return self.scale * float(requirement.limits[self.column])


YAW = Quantity(3, "yaw", "\N{DEGREE SIGN}", 180 / np.pi)
"""The heading."""
DEPTH = Quantity(0, "depth", "mm", 1000.0)
"""The distance, into the pallet."""
QUANTITIES = (YAW, DEPTH, Quantity(1, "along", "mm", 1000.0), Quantity(2, "height", "mm", 1000.0))
"""All of them."""


def prepare(axes: Axes) -> None:
    """Draw what lies behind the errors: a grid and the line of no error."""
    axes.axhline(0.0, color=INK, linewidth=1.0)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def reach(groups: Iterable[Sequence[PoseError]], of: Callable[[Sequence[PoseError]], FloatArray]) -> FloatArray:
    """Return a value for each error of all groups, (n,)."""
    parts = [of(group) for group in groups if group]
    return np.concatenate(parts) if parts else np.zeros(0)
