"""The pose of a body from surveyed points on it, with its covariance.

Small errors of a pose are (dx, dy, dz) of its origin and (wx, wy, wz) about the world's axes:
``point = origin + R b`` moves by ``d + w x (R b)``. The scale is one; `free_scale` is a diagnosis only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, LevelPose, level_pose

_MAX_ANGLE_SIGMA = math.radians(2.0)
"""Points that leave an angle more uncertain than this, in radians, do not fix it."""


class FitError(PalletLocError):
    """Points that do not fix a pose; gives the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class UncertainPose:
    """A pose with the covariance of its six small errors."""

    target_from_source: RigidTransform
    """The pose."""
    covariance: FloatArray
    """(6, 6) of the origin and of the rotation about the target's axes, in metres and radians."""

    @property
    def level(self) -> LevelPose:
        """Its level part."""
        return level_pose(self.target_from_source)

    @property
    def level_covariance(self) -> FloatArray:
        """(4, 4) covariance of (x, y, z, yaw) of the level part."""
        jacobian = np.zeros((4, 6))
        jacobian[:3, :3] = np.eye(3)
        x, y, z = self.target_from_source.as_matrix()[:3, 0]
        # The heading of an axis that rises turns by what the tilt does to its foot, too.
        jacobian[3, 3:] = np.array([-x * z, -y * z, x**2 + y**2]) / (x**2 + y**2)
        return np.asarray(jacobian @ self.covariance @ jacobian.T)

    @property
    def yaw_sigma(self) -> float:
        """Standard deviation of the heading, in radians."""
        return math.sqrt(self.level_covariance[3, 3])

    @property
    def tilt(self) -> float:
        """Angle of the source's z axis from the target's, in radians, 0 to pi."""
        axis = self.target_from_source.as_matrix()[:3, 2]
        return math.atan2(math.hypot(axis[0], axis[1]), axis[2])


@dataclass(frozen=True, slots=True, eq=False)
class BodyFit:
    """The pose of a body, and how well each point agrees with it."""

    pose: UncertainPose
    """``world_from_body``."""
    residuals: FloatArray
    """(n, 3) surveyed minus fitted, in the world, in metres."""
    leave_one_out: FloatArray
    """(n,) how far each point is from where the others say it is, in metres; NaN where they do not say."""
    assumed_level: bool
    """Whether roll and pitch were taken to be zero."""
    sigma: float
    """Standard deviation of each coordinate of a point, in metres."""

    @property
    def rms(self) -> float:
        """Root mean square distance of the points from the fit, in metres."""
        return math.sqrt(float((self.residuals**2).sum(axis=1).mean()))

    @property
    def freedom(self) -> int:
        """How many more numbers were measured than needed."""
        return self.residuals.size - (4 if self.assumed_level else 6)

    @property
    def chi2(self) -> float:
        """Squared residuals over the points' variance: as large as `freedom` on average."""
        return float((self.residuals**2).sum()) / self.sigma**2


def fit_rigid(body: FloatArray, world: FloatArray, sigma: float) -> BodyFit:
    """Fit rotation and translation to three or more points that do not lie on one line.

    The rotation comes from the singular value decomposition of the centred points (Arun; Umeyama without scale).

    Parameters
    ----------
    body : (n, 3) array
        The points on the body, in its own frame, in metres.
    world : (n, 3) array
        The same points as surveyed.
    sigma : float
        Standard deviation of each surveyed coordinate, in metres.

    Returns
    -------
    BodyFit
        ``world_from_body`` with its covariance.

    Raises
    ------
    FitError
        If there are fewer than three points, or they lie on one line for all that `sigma` tells.
    """
    return _fit(_rigid_rotation(body, world, sigma), body, world, sigma, assumed_level=False)


def fit_level(body: FloatArray, world: FloatArray, sigma: float) -> BodyFit:
    """Fit heading and translation to two or more points, for a body that stands level.

    Parameters
    ----------
    body, world, sigma
        As for `fit_rigid`.

    Returns
    -------
    BodyFit
        ``world_from_body`` without roll and pitch; their errors are taken to be zero, too.

    Raises
    ------
    FitError
        If there are fewer than two points, or they stand above one another and give no heading.

    Examples
    --------
    Two points 1.1 m apart, each good to 1 mm, give the heading to 0.07 degrees:

    >>> front = np.array([[0.0, 0.55, 0.0], [0.0, -0.55, 0.0]])
    >>> round(math.degrees(fit_level(front, front + [4.0, 2.0, 0.0], 1e-3).pose.yaw_sigma), 3)
    0.074
    """
    return _fit(_level_rotation(body, world, sigma), body, world, sigma, assumed_level=True)


def free_scale(body: FloatArray, world: FloatArray) -> float:
    """Return how much larger the surveyed points are than the body: a diagnosis, never part of a pose (Umeyama)."""
    centred, seen = body - body.mean(axis=0), world - world.mean(axis=0)
    turned = centred @ _proper_rotation(body, world).T
    return float((turned * seen).sum() / (centred**2).sum())


def is_mirrored(body: FloatArray, world: FloatArray, limit: float) -> bool:
    """Return whether the points fit the body's mirror image within a limit, and the body itself does not.

    Points on one plane fit both; their mirror image shows as a body that stands upside down.
    """
    centred, seen = body - body.mean(axis=0), world - world.mean(axis=0)
    rotation = _proper_rotation(body, world)
    reflection = _proper_rotation(-body, world)
    proper = np.linalg.norm(seen - centred @ rotation.T, axis=1).max()
    mirrored = np.linalg.norm(seen + centred @ reflection.T, axis=1).max()
    return bool(mirrored <= limit < proper)


def relative_pose(world_from_a: UncertainPose, world_from_b: UncertainPose) -> UncertainPose:
    """Return ``a_from_b`` of two independent poses, with its covariance.

    Parameters
    ----------
    world_from_a, world_from_b : UncertainPose
        Measured independently.

    Returns
    -------
    UncertainPose
        ``a_from_b``; an error of a's orientation moves b by its lever.
    """
    a, b = world_from_a.target_from_source, world_from_b.target_from_source
    back = a.as_matrix()[:3, :3].T
    lever = np.asarray(b.translation) - np.asarray(a.translation)
    by_a, by_b = np.zeros((6, 6)), np.zeros((6, 6))
    by_a[:3, :3], by_a[:3, 3:], by_a[3:, 3:] = -back, back @ skew(lever), -back
    by_b[:3, :3], by_b[3:, 3:] = back, back
    covariance = by_a @ world_from_a.covariance @ by_a.T + by_b @ world_from_b.covariance @ by_b.T
    return UncertainPose(a.inv() * b, (covariance + covariance.T) / 2)


def skew(vector: FloatArray) -> FloatArray:
    """Return the (3, 3) matrix S of a vector: ``S w`` is ``vector x w``."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])


def _rigid_rotation(body: FloatArray, world: FloatArray, sigma: float) -> FloatArray:
    if len(body) < 3:
        raise FitError(f"{_count(body)}, expected at least 3 where the tilt is free")
    spread = np.linalg.svd(body - body.mean(axis=0), compute_uv=False)
    if sigma > _MAX_ANGLE_SIGMA * spread[1]:
        off = spread[1] / math.sqrt(len(body))
        raise FitError(f"its {len(body)} points lie on one line, within {off * 1e3:.1f} mm, and do not fix the tilt")
    return _proper_rotation(body, world)


def _level_rotation(body: FloatArray, world: FloatArray, sigma: float) -> FloatArray:
    if len(body) < 2:
        raise FitError(f"{_count(body)}, expected at least 2")
    flat, seen = (body - body.mean(axis=0))[:, :2], (world - world.mean(axis=0))[:, :2]
    extent = math.sqrt(float((flat**2).sum()))
    if sigma > _MAX_ANGLE_SIGMA * extent:
        raise FitError(f"its {len(body)} points stand above one another and do not fix the heading")
    across = float((flat[:, 0] * seen[:, 1] - flat[:, 1] * seen[:, 0]).sum())
    yaw = math.atan2(across, float((flat * seen).sum()))
    return np.asarray(Rotation.from_euler("z", yaw).as_matrix())


def _count(body: FloatArray) -> str:
    return "it has 1 point" if len(body) == 1 else f"it has {len(body)} points"


def _proper_rotation(body: FloatArray, world: FloatArray) -> FloatArray:
    """Return the rotation that turns the centred body best; never a reflection."""
    correlation = (world - world.mean(axis=0)).T @ (body - body.mean(axis=0))
    left, _, right = np.linalg.svd(correlation)
    turn = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left) * np.linalg.det(right)))])
    return np.asarray(left @ turn @ right)


def _fit(rotation: FloatArray, body: FloatArray, world: FloatArray, sigma: float, *, assumed_level: bool) -> BodyFit:
    """Return the fit with this rotation: translation, residuals and covariance."""
    levers = body @ rotation.T
    origin = (world - levers).mean(axis=0)
    free = [0, 1, 2, 5] if assumed_level else [0, 1, 2, 3, 4, 5]
    motion = np.concatenate([np.hstack([np.eye(3), -skew(lever)]) for lever in levers])[:, free]
    covariance = np.zeros((6, 6))
    covariance[np.ix_(free, free)] = np.linalg.inv(motion.T @ motion) * sigma**2
    pose = UncertainPose(RigidTransform.from_components(origin, Rotation.from_matrix(rotation)), covariance)
    left_out = np.array([_left_out(index, levers, world, sigma, assumed_level) for index in range(len(body))])
    return BodyFit(pose, world - levers - origin, left_out, assumed_level, sigma)


def _left_out(index: int, levers: FloatArray, world: FloatArray, sigma: float, assumed_level: bool) -> float:
    """Return how far a point is from where the others say it is.

    The levers are turned already, so two others suffice: they correct the heading and keep the tilt.
    """
    others = np.arange(len(levers)) != index
    solve = _level_rotation if assumed_level or len(levers) == 3 else _rigid_rotation
    try:
        turn = solve(levers[others], world[others], sigma)
    except FitError:
        return math.nan
    origin = (world[others] - levers[others] @ turn.T).mean(axis=0)
    return float(np.linalg.norm(world[index] - turn @ levers[index] - origin))
