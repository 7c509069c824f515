"""What the errors of many shots come to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palletloc.evaluation.errors import ShotErrors
from palletloc.evaluation.spread import Spread, spread

FAR_BELOW = 0.6
"""How far below the camera a pallet's lower edge lies for a horizontal plane to serve well, in metres."""


@dataclass(frozen=True, slots=True)
class Summary:
    """The errors of many shots; NaN or None where there is nothing to count."""

    shots: int
    """Number of shots."""
    visible: int
    """Views of pallets that had to be found, over all shots."""
    found: int
    """Those that were."""
    false: int
    """Measurements that belong to no pallet."""
    yaw: Spread | None
    """Errors of the yaw, in radians."""
    depth: Spread | None
    """Errors across the front, in metres."""
    along: Spread | None
    """Errors along the front, in metres."""
    height: Spread | None
    """Errors of the height, in metres."""
    nees: float
    """Mean squared error in the covariance's own units: 4 where it tells the truth."""
    same_model: float
    """Part of the found pallets whose model is right, 0 to 1."""

    @property
    def recall(self) -> float:
        """Part of the visible pallets that was found, 0 to 1."""
        return self.found / self.visible if self.visible else float("nan")

    @property
    def false_per_shot(self) -> float:
        """False measurements per shot."""
        return self.false / self.shots if self.shots else float("nan")


def summarize(shots: Iterable[ShotErrors]) -> Summary:
    """Summarize the errors of shots.

    Parameters
    ----------
    shots : iterable of ShotErrors
        Of one or several recordings; `ShotErrors.between` keeps a part of each.

    Returns
    -------
    Summary
        Every view of a pallet counts once.
    """
    shots = list(shots)
    errors = [error for shot in shots for error in shot.errors]
    missed = sum(len(shot.missed) for shot in shots)
    return Summary(
        len(shots),
        len(errors) + missed,
        len(errors),
        sum(len(shot.false) for shot in shots),
        spread([error.yaw for error in errors]),
        spread([error.depth for error in errors]),
        spread([error.along for error in errors]),
        spread([error.height for error in errors]),
        _mean([error.nees for error in errors]),
        _mean([float(error.same_model) for error in errors]),
    )


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
