"""Do the level lines turn the face as the whole fit does? What the horizontal plane tells, read from their slopes.

The slope of a level line on the face's plane and its direction on the horizontal plane at its height are the same
measurement: ``slope = yaw (up_camera - up_line) / distance``. Where the lines lie well below or above the camera,
they give the yaw on their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.refinement.edges import SeenFace
from palletloc.robust import TUKEY, consensus

LEAST_SIGMA = 0.0005
"""Standard deviation that no line's yaw is below, in radians."""


@dataclass(frozen=True, slots=True)
class LevelYaw:
    """What the level lines say of the yaw."""

    turn: float
    """Against the pose at which the face was measured, in radians."""
    sigma: float
    """Standard deviation, in radians."""
    lines: int
    """How many lines agree."""


def yaw_from_level_lines(seen: SeenFace, slope_error_px: float) -> LevelYaw | None:
    """Return the yaw that the level lines give together.

    Parameters
    ----------
    seen : SeenFace
        The face with its measured edges.
    slope_error_px : float
        How far each end of an edge may lie off, in pixels of the image.

    Returns
    -------
    LevelYaw or None
        None where no level line is seen, or all are at the camera's height.
    """
    _, up, distance = seen.plane_from_camera
    level = [edge for edge in seen.edges if edge.edge.horizontal and not seen.loaded(edge.edge)]
    lever = np.array([(up - edge.edge.middle[1]) / distance for edge in level])
    level = [edge for edge, arm in zip(level, lever, strict=True) if abs(arm) > LEAST_SIGMA]
    lever = lever[np.abs(lever) > LEAST_SIGMA]
    if not level:
        return None
    tilt = [np.sqrt(2.0) * slope_error_px * edge.pixel / edge.edge.length for edge in level]
    sigma = np.maximum(np.hypot([edge.fit.sigma_slope for edge in level], tilt) / np.abs(lever), LEAST_SIGMA)
    turn = np.array([edge.fit.slope * edge.edge.outward[1] for edge in level]) / lever
    found = consensus(turn, sigma, TUKEY)
    return LevelYaw(found.mean, found.sigma, int(found.group.sum()))
