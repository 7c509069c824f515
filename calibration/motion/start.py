"""A start for the mounting from motions alone: how the camera moves while the forklift moves.

With ``V`` a motion of the forklift and ``A`` the same motion of the camera, ``V X = X A``. Rotations of the camera
have the vertical as their axis, which gives roll and pitch; then x, y, cos(yaw) and sin(yaw) follow from linear
equations (C. Guo, F. Mirzaei, S. Roumeliotis, "An analytical least-squares solution to the odometer-camera extrinsic
calibration problem", ICRA 2012), held weakly by the stated mounting where the motion does not tell.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import pose_from_bearings, refine_pose
from calibration.drive import relative
from calibration.motion.problem import MotionProblem, MotionState, odometry_at
from palletloc.geometry import FloatArray

_DELAYS = np.arange(-0.6, 0.601, 0.02)
"""Delays of the odometry that are tried, in seconds; the fit takes over from the best."""
_BETTER = 0.5
"""A delay is believed where the turns differ by less than this part of what they differ without one."""
_LEAST_TURN = 0.05
"""A motion that turns by less has no axis that counts, in radians."""
_STRAIGHT, _FAR = 0.03, 0.3
"""A motion that turns by less, in radians, and leads farther, in metres, shows where ahead is."""
_HELD = np.array([1.0, 1.0, 0.3, 0.3])
"""How weakly the stated x, y, cos(yaw) and sin(yaw) hold the linear start: metres, and parts of one."""
_PLACE_ERROR = 0.01
"""Typical error of a motion's place, in metres: it weighs the equations against what holds them."""
_AXES_WEIGHT = 0.1
"""The stated axes count as little as one turn by this angle, in radians: six degrees."""
_MOST_PAIRS = 400
"""Pairs of shots that are used at most: more do not make the start better."""


def start_motion(problem: MotionProblem) -> tuple[MotionProblem, MotionState] | None:
    """Return a problem with the lag at which the turns of camera and odometry agree, and a start for it.

    None where a target has no pose in any image.
    """
    seen = [_own_pose(problem, index) for index in range(len(problem.observations))]
    found = {corners.target for corners, pose in zip(problem.observations, seen, strict=True) if pose is not None}
    if found != set(range(problem.targets)):
        return None
    problem = replace(problem, lag=_delay(problem, seen))
    way = problem.way()
    camera = _camera(problem, seen, way)
    starts = [_state(problem, seen, way, pose) for pose in (camera, problem.stated)]
    return problem, min(starts, key=lambda state: float(np.log1p(problem.residuals(state) ** 2).sum()))


def _own_pose(problem: MotionProblem, index: int) -> RigidTransform | None:
    corners = problem.observations[index]
    start = pose_from_bearings(corners.points, corners.bearings)
    return (
        None
        if start is None
        else refine_pose(start, corners.points, corners.bearings, corners.origins, corners.sigma)
    )


def _motions(problem: MotionProblem, seen: list[RigidTransform | None]) -> list[tuple[int, int, RigidTransform]]:
    """Return pairs of shots that show the same target, each with the camera's motion between them."""
    by_target: list[list[int]] = [[] for _ in range(problem.targets)]
    for index, corners in enumerate(problem.observations):
        if seen[index] is not None:
            by_target[corners.target].append(index)
    pairs = [pair for same in by_target for pair in combinations(same, 2)]
    pairs = pairs[:: 1 + len(pairs) // _MOST_PAIRS]
    found = []
    for i, j in pairs:
        first, second = seen[i], seen[j]
        if first is not None and second is not None and problem.shot_of[i] != problem.shot_of[j]:
            found.append((problem.shot_of[i], problem.shot_of[j], first * second.inv()))
    return found


def _delay(problem: MotionProblem, seen: list[RigidTransform | None]) -> float:
    """Return the delay with which the turns of odometry and camera agree best; zero where there are none."""
    motions = _motions(problem, seen)
    if not motions:
        return 0.0
    first, last = (np.array([motion[i] for motion in motions]) for i in (0, 1))
    turned = np.array([motion[2].rotation.magnitude() for motion in motions])
    off = []
    for delay in _DELAYS:
        yaw = odometry_at(problem.odometry, problem.times + delay)[:, 2]
        off.append(np.square(np.abs(yaw[last] - yaw[first]) - turned).sum())
    best, plain = int(np.argmin(off)), int(np.argmin(np.abs(_DELAYS)))
    clear = off[best] < _BETTER * off[plain] and 0 < best < len(off) - 1
    return float(_DELAYS[best]) if clear else 0.0


def _camera(problem: MotionProblem, seen: list[RigidTransform | None], way: FloatArray) -> RigidTransform:
    motions = _motions(problem, seen)
    steps = relative(way[[i for i, _, _ in motions]], way[[j for _, j, _ in motions]])
    stated = problem.stated.rotation
    wanted, measured = [*(_AXES_WEIGHT * np.eye(3))], [*(_AXES_WEIGHT * stated.inv().apply(np.eye(3)))]
    for step, (_, _, motion) in zip(steps, motions, strict=True):
        if abs(step[2]) > _LEAST_TURN:
            wanted.append(np.array([0.0, 0.0, step[2]]))
            measured.append(motion.rotation.as_rotvec())
        elif abs(step[2]) < _STRAIGHT and np.hypot(*step[:2]) > _FAR:
            wanted.append(np.array([*step[:2], 0.0]))
            measured.append(motion.translation)
    rotation, _ = Rotation.align_vectors(np.array(wanted), np.array(measured))
    return _level_part(problem.stated, rotation, steps, [motion for _, _, motion in motions])


def _level_part(
    stated: RigidTransform, rotation: Rotation, steps: FloatArray, motions: list[RigidTransform]
) -> RigidTransform:
    """Return the pose with x, y and yaw by the linear equations."""
    rows, right = [np.diag(1 / _HELD)], [np.array([*stated.translation[:2], 1.0, 0.0]) / _HELD]
    for (x, y, yaw), motion in zip(steps, motions, strict=True):
        cos, sin = np.cos(yaw), np.sin(yaw)
        a, b, _ = rotation.apply(motion.translation)
        rows.append(np.array([[cos - 1, -sin, -a, b], [sin, cos - 1, -b, -a]]) / _PLACE_ERROR)
        right.append(np.array([-x, -y]) / _PLACE_ERROR)
    left, top, cosine, sine = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    turned = Rotation.from_euler("z", np.arctan2(sine, cosine)) * rotation
    return RigidTransform.from_components([left, top, stated.translation[2]], turned)


def _state(
    problem: MotionProblem, seen: list[RigidTransform | None], way: FloatArray, camera: RigidTransform
) -> MotionState:
    boards = np.zeros((problem.targets, 4, 4))
    for corners, shot, pose in reversed(list(zip(problem.observations, problem.shot_of, seen, strict=True))):
        if pose is not None:
            x, y, yaw = way[shot]
            odom = RigidTransform.from_components([x, y, 0.0], Rotation.from_euler("z", yaw))
            boards[corners.target] = (odom * camera * pose).as_matrix()
    return MotionState(camera, boards, way, delay=problem.lag)
