"""Do the level lines turn the face as the whole fit does? What the horizontal plane tells, read from their slopes.

The slope of a level line on the face's plane and its direction on the horizontal plane at its height are the same
measurement: ``slope = yaw (up_camera - up_line) / distance``. Where the lines lie well below or above the camera,
they give the yaw on their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.edge_fit import TUKEY
from palletloc.refinement.edges import SeenFace

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


def level_yaw(seen: SeenFace, slope_error_px: float) -> LevelYaw | None:
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
    level = [one for one in seen.edges if one.edge.horizontal and not seen.loaded(one.edge)]
    lever = np.array([(up - one.edge.middle[1]) / distance for one in level])
    level = [one for one, arm in zip(level, lever, strict=True) if abs(arm) > LEAST_SIGMA]
    lever = lever[np.abs(lever) > LEAST_SIGMA]
    if not level:
        return None
    tilt = [np.sqrt(2.0) * slope_error_px * one.pixel / one.edge.length for one in level]
    sigma = np.maximum(np.hypot([one.fit.sigma_slope for one in level], tilt) / np.abs(lever), LEAST_SIGMA)
    turn = np.array([one.fit.slope * one.edge.outward[1] for one in level]) / lever
    # the group around the line that most others agree with
    agree = np.abs(turn[:, None] - turn) < TUKEY * np.hypot(sigma[:, None], sigma)
    group = agree[int((agree / sigma**2).sum(axis=1).argmax())]
    weight = group / sigma**2
    mean = float((weight * turn).sum() / weight.sum())
    spread = float((weight * (turn - mean) ** 2).sum() / max(int(group.sum()) - 1, 1))
    return LevelYaw(mean, float(np.sqrt(max(spread, 1.0) / weight.sum())), int(group.sum()))
