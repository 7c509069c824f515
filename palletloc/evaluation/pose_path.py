"""A trajectory of full poses, for comparison with another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.time_pairing import Brackets, TimeRule, associated_pairs, brackets, require_overlap
from palletloc.geometry import FloatArray
from palletloc.trajectory import Trajectory

ASSOCIATION_LIMIT = 0.01
"""How far associated samples of two trajectories may be apart, in seconds, where nothing else is asked."""


@dataclass(frozen=True, slots=True, eq=False)
class PosePath:
    """Poses over time.

    Raises
    ------
    ValueError
        If there is no pose, not one per time, or the times do not increase.
    """

    times: FloatArray
    """(n,) strictly increasing, in seconds."""
    poses: RigidTransform
    """n transforms, ``target_from_body``."""

    def __post_init__(self) -> None:
        """Check that there is one pose for each time."""
        if self.poses.single or not len(self.poses) or np.shape(self.times) != (len(self.poses),):
            raise ValueError(f"expected one pose per time, got times of shape {np.shape(self.times)}")
        if not (np.diff(self.times) > 0).all():
            raise ValueError("expected strictly increasing times")

    @property
    def positions(self) -> FloatArray:
        """(n, 3) in metres."""
        return np.asarray(self.poses.translation)

    def between(self, where: Brackets) -> RigidTransform:
        """Return the poses between neighbouring samples: straight in position, at a constant rate in rotation.

        Parameters
        ----------
        where : Brackets
            From these times.

        Returns
        -------
        RigidTransform
            One for each wanted time that is between samples.
        """
        share = where.share[:, None]
        rotations = self.poses.rotation
        turn = (rotations[where.before].inv() * rotations[where.after]).as_rotvec()
        return RigidTransform.from_components(
            (1 - share) * self.positions[where.before] + share * self.positions[where.after],
            rotations[where.before] * Rotation.from_rotvec(share * turn),
        )


def level_path(trajectory: Trajectory) -> PosePath:
    """Return a level trajectory as full poses."""
    heights = np.zeros_like(trajectory.x) if trajectory.z is None else trajectory.z
    positions = np.column_stack([trajectory.x, trajectory.y, heights])
    rotations = Rotation.from_euler("z", np.asarray(trajectory.yaw)[:, None])
    return PosePath(trajectory.times, RigidTransform.from_components(positions, rotations))


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """Poses of a reference and an estimate that belong together, one to one."""

    times: FloatArray
    """(n,) when they hold, in seconds: those of the shorter trajectory, or of the estimate if interpolated."""
    reference: RigidTransform
    """n poses of the reference."""
    estimate: RigidTransform
    """n poses of the estimate."""
    rule: TimeRule
    """How the poses of the reference were taken."""
    limit: float
    """Largest time between associated samples, or between the two that were interpolated, in seconds."""
    largest: float
    """Largest time between associated samples that there is, in seconds; 0 where interpolated."""


def associate(
    reference: PosePath, estimate: PosePath, limit: float = ASSOCIATION_LIMIT, offset: float = 0.0
) -> Association:
    """Associate samples by the rule of evo; see `palletloc.evaluation.time_pairing.associated_pairs`.

    Parameters
    ----------
    reference, estimate : PosePath
        The two trajectories.
    limit : float
        Largest time between two samples, in seconds.
    offset : float
        Added to the times of the estimate, in seconds.

    Returns
    -------
    Association
        Samples of both; one may serve twice.

    Raises
    ------
    EvaluationError
        If the two have no time in common, or no samples within the limit.
    """
    shifted = estimate.times + offset
    require_overlap(reference.times, shifted, ("reference", "estimate"), slack=limit)
    pairs = associated_pairs(reference.times, shifted, limit)
    if not len(pairs.first):
        raise EvaluationError(f"no sample of the estimate lies within {limit:.6g} s of one of the reference")
    by_reference = len(shifted) > len(reference.times)
    return Association(
        reference.times[pairs.first] if by_reference else shifted[pairs.second],
        reference.poses[pairs.first],
        estimate.poses[pairs.second],
        TimeRule.NEAREST,
        limit,
        float(np.abs(pairs.apart).max()),
    )


def interpolate(reference: PosePath, estimate: PosePath, limit: float, offset: float = 0.0) -> Association:
    """Take the reference between its samples at the times of the estimate.

    Parameters
    ----------
    reference, estimate, offset
        As for `associate`.
    limit : float
        Longest gap in the reference to interpolate across, in seconds.

    Returns
    -------
    Association
        Without the poses of the estimate outside the reference or in a longer gap.

    Raises
    ------
    EvaluationError
        If the two have no time in common, or every pose of the estimate is in a longer gap.
    """
    shifted = estimate.times + offset
    require_overlap(reference.times, shifted, ("reference", "estimate"))
    where = brackets(shifted, reference.times, limit)
    if not len(where.wanted):
        raise EvaluationError(f"no sample of the estimate lies in a gap of the reference of at most {limit:.6g} s")
    return Association(
        shifted[where.wanted],
        reference.between(where),
        estimate.poses[where.wanted],
        TimeRule.INTERPOLATED,
        limit,
        0.0,
    )
