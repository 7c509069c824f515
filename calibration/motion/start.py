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

from calibration.bearing_dlt import pose_from_bearings, refine_pose
from calibration.drive import relative
from calibration.motion.network import MotionNetwork, MotionState, odometry_at
from palletloc.geometry import FloatArray

_DELAYS = np.arange(-0.6, 0.601, 0.02)
_LEAST_TURN, _BETTER = 0.05, 0.5
_STRAIGHT, _FAR = 0.03, 0.3
_HELD = np.array([1.0, 1.0, 0.3, 0.3])
_MOST_PAIRS = 400


def start_motion(network: MotionNetwork) -> tuple[MotionNetwork, MotionState] | None:
    """Return a start, or None where a target has no pose in any image.

    Parameters
    ----------
    network : MotionNetwork
        The observations.

    Returns
    -------
    network : MotionNetwork
        With the lag at which the turns of camera and odometry agree.
    state : MotionState
        The start.
    """
    seen = [_own_pose(network, index) for index in range(len(network.sights))]
    found = {one.target for one, pose in zip(network.sights, seen, strict=True) if pose is not None}
    if found != set(range(network.targets)):
        return None
    network = replace(network, lag=_delay(network, seen))
    way = network.way()
    camera = _camera(network, seen, way)
    starts = [_state(network, seen, way, one) for one in (camera, network.stated)]
    return network, min(starts, key=lambda state: _cost(network, state))


def _cost(network: MotionNetwork, state: MotionState) -> float:
    return float(np.log1p(network.residuals(state) ** 2).sum())


def _own_pose(network: MotionNetwork, index: int) -> RigidTransform | None:
    sight = network.sights[index]
    start = pose_from_bearings(sight.points, sight.bearings)
    return None if start is None else refine_pose(start, sight.points, sight.bearings, sight.origins, sight.sigma)


def _motions(network: MotionNetwork, seen: list[RigidTransform | None]) -> list[tuple[int, int, RigidTransform]]:
    """Return pairs of shots that show the same target, each with the camera's motion between them."""
    by_target: list[list[int]] = [[] for _ in range(network.targets)]
    for index, sight in enumerate(network.sights):
        if seen[index] is not None:
            by_target[sight.target].append(index)
    pairs = [pair for same in by_target for pair in combinations(same, 2)]
    pairs = pairs[:: 1 + len(pairs) // _MOST_PAIRS]
    found = []
    for i, j in pairs:
        one, other = seen[i], seen[j]
        if one is not None and other is not None and network.shot_of[i] != network.shot_of[j]:
            found.append((network.shot_of[i], network.shot_of[j], one * other.inv()))
    return found


def _delay(network: MotionNetwork, seen: list[RigidTransform | None]) -> float:
    """Return the delay with which the turns of odometry and camera agree best; zero where there are none."""
    motions = _motions(network, seen)
    if not motions:
        return 0.0
    first, last = (np.array([motion[i] for motion in motions]) for i in (0, 1))
    turned = np.array([motion[2].rotation.magnitude() for motion in motions])
    off = []
    for delay in _DELAYS:
        yaw = odometry_at(network.odometry, network.times + delay)[:, 2]
        off.append(np.square(np.abs(yaw[last] - yaw[first]) - turned).sum())
    best, plain = int(np.argmin(off)), int(np.argmin(np.abs(_DELAYS)))
    clear = off[best] < _BETTER * off[plain] and 0 < best < len(off) - 1
    return float(_DELAYS[best]) if clear else 0.0


def _camera(network: MotionNetwork, seen: list[RigidTransform | None], way: FloatArray) -> RigidTransform:
    motions = _motions(network, seen)
    steps = relative(way[[i for i, _, _ in motions]], way[[j for _, j, _ in motions]])
    stated = network.stated.rotation
    # The stated axes count as little as one turn by a few degrees.
    wanted, measured = [*(0.1 * np.eye(3))], [*(0.1 * stated.inv().apply(np.eye(3)))]
    for step, (_, _, motion) in zip(steps, motions, strict=True):
        if abs(step[2]) > _LEAST_TURN:
            wanted.append(np.array([0.0, 0.0, step[2]]))
            measured.append(motion.rotation.as_rotvec())
        elif abs(step[2]) < _STRAIGHT and np.hypot(*step[:2]) > _FAR:
            wanted.append(np.array([*step[:2], 0.0]))
            measured.append(motion.translation)
    rotation, _ = Rotation.align_vectors(np.array(wanted), np.array(measured))
    return _level_part(network.stated, rotation, steps, [motion for _, _, motion in motions])


def _level_part(
    stated: RigidTransform, rotation: Rotation, steps: FloatArray, motions: list[RigidTransform]
) -> RigidTransform:
    """Return the pose with x, y and yaw by the linear equations."""
    rows, right = [np.diag(1 / _HELD)], [np.array([*stated.translation[:2], 1.0, 0.0]) / _HELD]
    for (x, y, yaw), motion in zip(steps, motions, strict=True):
        cos, sin = np.cos(yaw), np.sin(yaw)
        a, b, _ = rotation.apply(motion.translation)
        rows.append(np.array([[cos - 1, -sin, -a, b], [sin, cos - 1, -b, -a]]) / 0.01)
        right.append(np.array([-x, -y]) / 0.01)
    left, top, cosine, sine = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    turned = Rotation.from_euler("z", np.arctan2(sine, cosine)) * rotation
    return RigidTransform.from_components([left, top, stated.translation[2]], turned)


def _state(
    network: MotionNetwork,
    seen: list[RigidTransform | None],
    way: FloatArray,
    camera: RigidTransform,
) -> MotionState:
    boards = np.zeros((network.targets, 4, 4))
    for sight, shot, pose in reversed(list(zip(network.sights, network.shot_of, seen, strict=True))):
        if pose is not None:
            x, y, yaw = way[shot]
            odom = RigidTransform.from_components([x, y, 0.0], Rotation.from_euler("z", yaw))
            boards[sight.target] = (odom * camera * pose).as_matrix()
    return MotionState(camera, boards, way, delay=network.lag)
