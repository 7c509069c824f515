"""The error of one estimate, beside what the estimate and the truth say of their own uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.evaluation.errors import PoseError, TrueFace, pose_error
from palletloc.evaluation.estimate import PalletEstimate
from palletloc.evaluation.normalised import nees, normalised
from palletloc.geometry import FloatArray

COMPONENTS = ("depth", "along", "height", "yaw")
"""Of an error in the true pallet's axes, in the order of all arrays: three in metres, one in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimateError:
    """An estimate with the pallet that it belongs to."""

    time: float
    """The shot's, in seconds: the same for all runs of a recording."""
    estimate: PalletEstimate
    """The estimate."""
    error: PoseError
    """Estimate minus truth; ``error.face`` is the pallet."""
    estimate_covariance: FloatArray
    """(4, 4) that the estimate states of depth, along, height and yaw."""
    truth_covariance: FloatArray | None
    """(4, 4) that the truth states of the same; None where the truth states none."""

    @property
    def offset(self) -> FloatArray:
        """(4,) errors of depth, along and height in metres, and of yaw in radians."""
        return np.array([self.error.depth, self.error.along, self.error.height, self.error.yaw])

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of the offset: the estimate's, with the truth's where there is one."""
        if self.truth_covariance is None:
            return self.estimate_covariance
        return self.estimate_covariance + self.truth_covariance

    @property
    def normalised(self) -> FloatArray:
        """(4,) errors in units of their standard deviation, the truth's included."""
        return normalised(self.offset, np.diag(self.covariance))

    @property
    def nees(self) -> float:
        """Squared error in units of the estimate's covariance alone, as if the truth were exact."""
        return self.error.nees

    @property
    def nees_with_truth(self) -> float:
        """The same in units of the sum of both covariances; `nees` where the truth states none."""
        return nees(self.offset, self.covariance)


def estimate_error(
    time: float, estimate: PalletEstimate, face: TrueFace, truth_covariance: FloatArray | None = None
) -> EstimateError:
    """Compare an estimate with the pallet that it belongs to.

    Parameters
    ----------
    time : float
        The shot's, in seconds.
    estimate : PalletEstimate
        With its covariance.
    face : TrueFace
        The truth.
    truth_covariance : (4, 4) array, optional
        Of the true (x, y, z, yaw) in the forklift frame, in metres and radians; the errors of truth and
        estimate are taken as independent.

    Returns
    -------
    EstimateError
        In the true pallet's axes.
    """
    turn = _pallet_from_forklift(face.forklift_from_pallet.yaw)
    return EstimateError(
        time,
        estimate,
        pose_error(estimate, face),
        turn @ estimate.covariance @ turn.T,
        None if truth_covariance is None else turn @ truth_covariance @ turn.T,
    )


def _pallet_from_forklift(yaw: float) -> FloatArray:
    """Return the (4, 4) rotation of a difference (x, y, z, yaw) into the axes of a pallet with that yaw."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, sin, 0, 0], [-sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def offsets(errors: Sequence[EstimateError]) -> FloatArray:
    """Return the (n, 4) errors of depth, along and height in metres, and of yaw in radians."""
    return np.array([one.offset for one in errors]).reshape(-1, 4)
