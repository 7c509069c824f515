"""Absolute and relative pose errors (APE, RPE) of a trajectory, as evo defines them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.step_pairs import StepPairs
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseDeviations:
    """How far transforms that should be the identity are from it."""

    translation: FloatArray
    """(n,) length of the translation, in metres."""
    rotation: FloatArray
    """(n,) angle of the rotation, in radians, 0 to pi."""
    rotation_part: FloatArray
    """(n,) Frobenius norm of the rotation matrix minus the identity; without unit."""
    full: FloatArray
    """(n,) Frobenius norm of the 4 x 4 matrix minus the identity; mixes units, with metres for the translation."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """What evo reports of errors that are not negative."""

    n: int
    """How many there are."""
    rmse: float
    """Root of the mean square."""
    mean: float
    """Mean."""
    median: float
    """Median."""
    std: float
    """Standard deviation, with n in the denominator."""
    minimum: float
    """The smallest."""
    maximum: float
    """The largest."""
    sse: float
    """Sum of squares."""


def absolute_errors(reference: RigidTransform, estimate: RigidTransform) -> PoseDeviations:
    r"""Return the absolute pose error (APE): :math:`E_i = Q_i^{-1} P_i` for reference *Q* and estimate *P*.

    Parameters
    ----------
    reference, estimate : RigidTransform
        n poses each that belong together, in one frame; see `palletloc.evaluation.alignment.align`.

    Returns
    -------
    PoseDeviations
        One for each pose.
    """
    return _deviations(reference.inv() * estimate)


def relative_errors(reference: RigidTransform, estimate: RigidTransform, steps: StepPairs) -> PoseDeviations:
    r"""Return the relative pose error (RPE): :math:`E = (Q_i^{-1} Q_j)^{-1} (P_i^{-1} P_j)`.

    It needs no alignment: a rigid motion of either trajectory cancels.

    Parameters
    ----------
    reference, estimate : RigidTransform
        n poses each that belong together.
    steps : StepPairs
        Which poses *i* and *j* to compare.

    Returns
    -------
    PoseDeviations
        One for each step.
    """
    return _deviations(_motions(reference, steps).inv() * _motions(estimate, steps))


def distance_errors(reference: RigidTransform, estimate: RigidTransform, steps: StepPairs) -> FloatArray:
    """Return by how much the straight distances between the poses of steps differ.

    Returns
    -------
    (k,) array
        Absolute differences, in metres; they do not depend on the rotations.
    """
    true, found = (
        np.linalg.norm(path.translation[steps.last] - path.translation[steps.first], axis=1)
        for path in (reference, estimate)
    )
    return np.asarray(np.abs(found - true))


def _motions(poses: RigidTransform, steps: StepPairs) -> RigidTransform:
    return poses[steps.first].inv() * poses[steps.last]


def _deviations(errors: RigidTransform) -> PoseDeviations:
    matrices = errors.as_matrix() - np.eye(4)
    return PoseDeviations(
        np.linalg.norm(errors.translation, axis=1),
        np.asarray(errors.rotation.magnitude()),
        np.linalg.norm(matrices[:, :3, :3], axis=(1, 2)),
        np.linalg.norm(matrices, axis=(1, 2)),
    )


def statistics(errors: ArrayLike) -> Statistics:
    """Return evo's statistics.

    Parameters
    ----------
    errors : (n,) array_like
        At least one.

    Returns
    -------
    Statistics
        In the unit of the errors.

    Raises
    ------
    ValueError
        If there is none.

    Examples
    --------
    >>> found = statistics([3.0, 4.0])
    >>> found.mean, found.std, found.sse
    (3.5, 0.5, 25.0)
    """
    values = np.asarray(errors, dtype=np.float64)
    if not values.size:
        raise ValueError("expected at least one error")
    squares = values**2
    return Statistics(
        n=values.size,
        rmse=float(np.sqrt(squares.mean())),
        mean=float(values.mean()),
        median=float(np.median(values)),
        std=float(values.std()),
        minimum=float(values.min()),
        maximum=float(values.max()),
        sse=float(squares.sum()),
    )
