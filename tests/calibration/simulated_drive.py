"""Drives past targets with their truth, as bearings without images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import DriveNoise, compose, relative
from calibration.motion.problem import Height, MotionProblem
from calibration.targets.targets import PrintedPattern, on_board
from palletloc.geometry import FloatArray
from palletloc.trajectory import Trajectory
from tests.calibration.simulated_yard import seen

RATE = 50.0
"""Samples of the odometry per second."""


@dataclass(frozen=True, slots=True)
class DriveErrors:
    """What is wrong with a simulated drive."""

    noise: DriveNoise = DriveNoise()
    """Random errors of the odometry that are drawn."""
    scale: float = 1.0
    """True distance over the odometry's."""
    bias: float = 0.0
    """What its yaw rate has too much, in radians per second."""
    delay: float = 0.0
    """What its clock shows more than the camera's, in seconds."""
    bearing: float = 5e-5
    """Standard deviation of each bearing across itself, in radians."""
    slips: tuple[tuple[float, float], ...] = ()
    """When wheels spin, in seconds, and how much farther the odometry then comes, in metres."""
    drawn: bool = True
    """Whether random errors are drawn."""


def drive_of(segments: Sequence[tuple[float, float, float]]) -> Trajectory:
    """Return a way of pieces, (s, m/s, rad/s) each, with constant rates, joined within a third of a second."""
    rates = np.concatenate([np.tile([speed, turn], (round(time * RATE), 1)) for time, speed, turn in segments])
    window = np.hanning(round(RATE / 3) + 2)
    padded = np.pad(rates, ((len(window), len(window)), (0, 0)), mode="edge")
    smooth = [np.convolve(rate, window / window.sum(), mode="same")[len(window) : -len(window)] for rate in padded.T]
    speed, turn = smooth
    pose, poses = np.zeros(3), [np.zeros(3)]
    for v, w in zip(speed / RATE, turn / RATE, strict=True):
        pose = compose(pose, np.array([v * np.cos(w / 2), v * np.sin(w / 2), w]))
        poses.append(pose)
    return Trajectory(np.arange(len(poses)) / RATE, *np.array(poses).T)


def simulate_drive(
    truth: Trajectory, forklift_from_camera: RigidTransform, boards: Sequence[tuple[PrintedPattern, RigidTransform]],
    stated: RigidTransform, errors: DriveErrors, heights: Mapping[int, Height], *, shots: int, seed: int,
    scale_sigma: float,
) -> MotionProblem:  # fmt: skip
    """Return what a camera and the odometry of a forklift would say; `truth` is ``odom_from_forklift``.

    `boards` come with ``odom_from_board``, `heights` are of targets whose height is known, `stated` is the mounting.
    """
    rng = np.random.default_rng([seed, 5])
    times = np.linspace(truth.times[0] + 0.7, truth.times[-1] - 0.7, shots)
    observations, shot_of = [], []
    for index, time in enumerate(times):
        pose = truth.pose_at(float(time))
        odom = RigidTransform.from_components([pose.x, pose.y, 0.0], Rotation.from_euler("z", pose.yaw))
        for k, (pattern, board) in enumerate(boards):
            points = on_board(pattern.corners)
            rays = (odom * forklift_from_camera).inv().apply(board.apply(points))
            observations.append(seen(k, points, rays, errors.bearing, rng if errors.drawn else None))
            shot_of.append(index)
    return MotionProblem(
        times, _measured(truth, errors, rng), errors.noise, tuple(observations), tuple(shot_of), len(boards), stated,
        dict(heights), scale_sigma=scale_sigma,
    )  # fmt: skip


def _measured(truth: Trajectory, errors: DriveErrors, rng: np.random.Generator) -> Trajectory:
    """Return the odometry: a true way whose increments are wrong."""
    poses = np.stack([truth.x, truth.y, truth.yaw], axis=1)
    steps, duration = relative(poses[:-1], poses[1:]), np.diff(truth.times)[:, None]
    sigma: FloatArray = np.array([errors.noise.position, errors.noise.position, errors.noise.heading])
    steps = steps / [errors.scale, errors.scale, 1.0] + [0.0, 0.0, errors.bias] * duration
    steps += errors.drawn * rng.normal(size=steps.shape) * sigma * np.sqrt(duration)
    for time, length in errors.slips:
        steps[np.searchsorted(truth.times, time) - 1, 0] += length
    pose, measured = poses[0], [poses[0]]
    for step in steps:
        pose = compose(pose, step)
        measured.append(pose)
    return Trajectory(truth.times + errors.delay, *np.array(measured).T)
