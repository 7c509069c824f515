"""Bringing an estimated trajectory into the frame of its reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.errors import EvaluationError
from palletloc.geometry import FloatArray

STRAIGHT = 0.01
"""Second by first principal extent below which positions count as a straight line: 1 cm beside a metre."""


class Alignment(StrEnum):
    """What is taken as unknown between the frames of estimate and reference."""

    NONE = "none"
    """Nothing: both are in one frame, as with a surveyed one."""
    ORIGIN = "origin"
    """A rigid motion; the first poses are made equal."""
    POSYAW = "posyaw"
    """A translation and a rotation about the vertical; least squares of the positions."""
    RIGID = "se3"
    """A rigid motion; least squares of the positions."""
    SIMILARITY = "sim3"
    """A rigid motion and a scale. A scale that differs from 1 is a finding, so this is for diagnosis only."""


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """An estimate in the frame of its reference."""

    method: Alignment
    """What was taken as unknown."""
    reference_from_estimate: RigidTransform
    """The motion that was found; applied after the scale."""
    scale: float
    """The scale that was applied to the estimate's positions: 1 except for `Alignment.SIMILARITY`."""
    estimate: RigidTransform
    """n aligned poses."""


def align(reference: RigidTransform, estimate: RigidTransform, method: Alignment) -> Aligned:
    """Bring an estimate into the frame of its reference.

    Parameters
    ----------
    reference, estimate : RigidTransform
        n poses each that belong together.
    method : Alignment
        What is unknown.

    Returns
    -------
    Aligned
        With the aligned poses.

    Raises
    ------
    EvaluationError
        If the positions do not determine the alignment: those of a straight approach do not tell how the
        estimate is turned about the line of travel.
    ValueError
        If the numbers of poses differ or are zero.
    """
    if len(reference) != len(estimate) or not len(reference):
        raise ValueError(f"expected as many poses of both, got {len(reference)} and {len(estimate)}")
    scale, motion = 1.0, RigidTransform.identity()
    if method is Alignment.ORIGIN:
        motion = reference[0] * estimate[0].inv()
    elif method is Alignment.POSYAW:
        motion = posyaw(reference.translation, estimate.translation)
    elif method is not Alignment.NONE:
        motion, scale = umeyama(
            reference.translation, estimate.translation, with_scale=method is Alignment.SIMILARITY
        )
    scaled = RigidTransform.from_components(scale * estimate.translation, estimate.rotation)
    return Aligned(method, motion, scale, motion * scaled)


def posyaw(reference: FloatArray, estimate: FloatArray) -> RigidTransform:
    r"""Return the translation and the turn about the vertical that fit positions best.

    With positions :math:`(x, y, z)` about their means, primed in the reference, the yaw that minimises the
    sum of squared distances is

    .. math:: \psi = \operatorname{atan2}\Bigl(\sum x y' - y x',\ \sum x x' + y y'\Bigr).

    Parameters
    ----------
    reference, estimate : (n, 3) array
        Positions that belong together, in metres.

    Returns
    -------
    RigidTransform
        ``reference_from_estimate``.

    Raises
    ------
    EvaluationError
        If the positions do not move in the horizontal plane, so that no yaw follows from them.
    """
    (a, b), (mean_a, mean_b) = _centred(reference, estimate)
    cross = float((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum())
    dot = float((b[:, :2] * a[:, :2]).sum())
    extent = math.sqrt(float((a[:, :2] ** 2).sum()) * float((b[:, :2] ** 2).sum()))
    if math.hypot(cross, dot) <= 1e-9 * max(extent, 1e-9):
        raise EvaluationError(
            "the positions do not move in the horizontal plane, so they give no yaw;"
            f" use the alignment '{Alignment.ORIGIN}' or '{Alignment.NONE}'"
        )
    turn = Rotation.from_euler("z", math.atan2(cross, dot))
    return RigidTransform.from_components(mean_a - turn.apply(mean_b), turn)


def umeyama(reference: FloatArray, estimate: FloatArray, *, with_scale: bool = False) -> tuple[RigidTransform, float]:
    r"""Return the rigid motion, or the similarity, that fits positions best.

    With :math:`\Sigma = \frac{1}{n} \sum (p'_i - \bar p')(p_i - \bar p)^T = U D V^T` and
    :math:`S = \operatorname{diag}(1, 1, \pm 1)` so that the rotation is proper,

    .. math:: R = U S V^T, \qquad c = \operatorname{tr}(D S) / \sigma_p^2, \qquad t = \bar p' - c R \bar p

    (Umeyama, *IEEE Transactions on Pattern Analysis and Machine Intelligence* 13, 1991).

    Parameters
    ----------
    reference, estimate : (n, 3) array
        Positions :math:`p'` and :math:`p` that belong together, in metres.
    with_scale : bool
        Whether to fit :math:`c`, too; otherwise it is 1.

    Returns
    -------
    (RigidTransform, float)
        ``reference_from_estimate`` and the scale.

    Raises
    ------
    EvaluationError
        If the positions lie on a straight line, by `STRAIGHT`, or in one place.
    """
    (a, b), (mean_a, mean_b) = _centred(reference, estimate)
    U, D, Vt = np.linalg.svd(a.T @ b / len(a))
    _require_breadth(D)
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    rotation = U * S @ Vt
    scale = float(D @ S / np.mean((b**2).sum(axis=1))) if with_scale else 1.0
    motion = RigidTransform.from_components(mean_a - scale * rotation @ mean_b, Rotation.from_matrix(rotation))
    return motion, scale


def _centred(*positions: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    means = [points.mean(axis=0) for points in positions]
    return [points - mean for points, mean in zip(positions, means, strict=True)], means


def _require_breadth(singular: FloatArray) -> None:
    """Refuse positions that leave a rotation open; the roots of the singular values are extents."""
    if singular[0] > np.finfo(np.float64).eps and math.sqrt(singular[1] / singular[0]) >= STRAIGHT:
        return
    what = "on a straight line" if singular[0] > np.finfo(np.float64).eps else "in one place"
    raise EvaluationError(
        f"the positions lie {what}, so they do not tell how the estimate is turned;"
        f" use the alignment '{Alignment.POSYAW}' or '{Alignment.NONE}'"
    )
