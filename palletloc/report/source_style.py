"""How single shots, tracks and surveyed stops look in the figures of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import DEGREE, GRID, SERIES, add_text, new_figure
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
NONE = "\N{EN DASH}"
"""What tables write where there is no number."""
DOTTED = (0, (1, 2))
"""Line of a requirement's limit: offset, then points drawn and left out."""
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
        return self.scale * np.array([error.offset[self.column] for error in errors])

    def sigmas(self, errors: Sequence[PoseError]) -> FloatArray:
        """Return the standard deviations in the unit, (n,)."""
        return self.scale * np.sqrt([error.covariance[self.column, self.column] for error in errors])

    @property
    def digits(self) -> int:
        """Decimals of its errors in tables."""
        return 2 if self.unit == DEGREE else 1

    def sizes_text(self, offsets: FloatArray) -> str:
        """Return median and 95 % of the absolute errors as tables write them; empty without an error.

        Parameters
        ----------
        offsets : (n, 4) array
            Errors of depth, along and height in metres, and of yaw in radians.
        """
        sizes = self.scale * np.abs(offsets[:, self.column])
        ends = (np.median(sizes), np.percentile(sizes, 95)) if len(sizes) else ()
        return " / ".join(f"{value:.{self.digits}f}" for value in ends)

    def limit(self, requirement: Requirement) -> float:
        """Return the largest error that is allowed, in the unit."""
        return self.scale * float(requirement.limits[self.column])


YAW = Quantity(3, "yaw", DEGREE, 180 / np.pi)
"""The heading."""
DEPTH = Quantity(0, "depth", "mm", 1000.0)
"""The distance, into the pallet."""
QUANTITIES = (YAW, DEPTH, Quantity(1, "along", "mm", 1000.0), Quantity(2, "height", "mm", 1000.0))
"""All of them."""


def titled_figure(height_px: float, title: str, explained: str, left: float = 76) -> Figure:
    """Return an empty figure with a title and a line that explains its marks, ``left`` pixels from the border."""
    figure = new_figure(height_px)
    add_text(figure, left, 14, title, size=13, bold=True)
    add_text(figure, left, 40, explained, size=10.5)
    return figure


def add_grid(axes: Axes) -> None:
    """Draw a grid behind the errors."""
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
