"""What each target says about the others: the pose without it, and where the rest expects it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from calibration.extrinsics import Extrinsics, resolve, turn_to
from calibration.network import Network, board_columns
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """One target left out."""

    target: str
    """Its name."""
    shift: FloatArray
    """(6,) how the camera's pose moves without it, in metres and radians."""
    shift_in_sigma: FloatArray
    """(6,) the same, in units of the full solution's standard deviations."""
    shift_in_rest_sigma: FloatArray
    """(6,) the same, in units of the standard deviations without it."""
    distance: float
    """Between its surveyed corners and where the others expect them, root mean square, in metres."""
    probability: float
    """Of such a distance or a larger one by chance."""
    rest_probability: float
    """Of the remaining survey's contradictions by chance."""


def survey_test(solution: Extrinsics) -> float:
    """Return how probable the survey's residuals are by chance, with the standard deviations as stated."""
    network = solution.network
    jacobian = network.jacobian(solution.poses)[network.image_rows :]
    residuals = network.residuals(solution.poses)[network.image_rows :]
    taken = np.einsum("ij,jk,ik->i", jacobian, solution.full_covariance, jacobian)
    redundancy = float((1 - taken).sum())
    return float(chi2.sf(residuals @ residuals, redundancy)) if redundancy > 0.5 else 1.0


def leave_each_out(solution: Extrinsics) -> tuple[LeftOut, ...]:
    """Leave out one target after the other.

    The target stays in the fit, but nothing holds it: where it ends up is where the others expect it.

    Parameters
    ----------
    solution : Extrinsics
        With all targets, two at least.
    """
    network = replace(solution.network, survey_scale=1.0)
    return tuple(_left_out(solution, network, k) for k in range(len(network.surveys)))


def _left_out(solution: Extrinsics, network: Network, target: int) -> LeftOut:
    rest = resolve(solution, network.without_survey(target))
    survey, pose = network.surveys[target], rest.poses.boards[target]
    off = pose.apply(survey.outline) - survey.points
    rows, columns = network.predicted_rows(target, rest.poses), board_columns(target)
    covariance = rows @ rest.full_covariance[columns, columns] @ rows.T + survey.sigma**2 * np.eye(9)
    distance = float(off.ravel() @ np.linalg.solve(covariance, off.ravel()))
    moved = rest.poses.camera.translation - solution.poses.camera.translation
    turned = turn_to(solution.poses.camera.rotation, rest.poses.camera.rotation)
    shift = np.concatenate([moved, turned])
    return LeftOut(
        survey.name,
        shift,
        shift / solution.sigma,
        shift / np.maximum(rest.sigma, solution.sigma),
        float(np.sqrt((off**2).sum(-1).mean())),
        float(chi2.sf(distance, 9)),
        survey_test(rest),
    )
