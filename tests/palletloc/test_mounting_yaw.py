"""The turn of a camera as a drive tells it. All is drawn: a drive that swings, its odometry, and what is seen."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.mounting_yaw import SeenTurn, seen_turn, turn_lines
from palletloc.trajectory import Trajectory

CAMERA = RigidTransform.from_components([0.3, -0.1, 1.8], Rotation.from_euler("ZYX", [-1.2, 0.9, -0.7], degrees=True))
ROW = tuple(LevelPose(2.0 + 1.25 * n, 1.8 + 0.02 * n, z, 1.55) for n in range(3) for z in (0.0, 1.55))
SIGMA = np.array([0.008, 0.005, 0.003, math.radians(0.3)])
WAY = 3.0


@dataclass(frozen=True)
class Approach:
    odometry: Trajectory
    rows: tuple[PalletMeasurement, ...]


def planar(x: float, y: float, yaw: float) -> RigidTransform:
    return RigidTransform.from_components([x, y, 0.0], Rotation.from_euler("z", yaw))


def approach(
    seed: int, turned_deg: float = 0.0, way: float = WAY, pallets: tuple[LevelPose, ...] = ROW, shift: float = 0.0
) -> Approach:
    """Draw an approach of six seconds whose mounting is stated with a yaw, and a place, that is off."""
    rng, times = np.random.default_rng(seed), np.arange(0.0, 6.01, 0.02)
    x = way * times / 6
    y, yaw = 0.04 * np.sin(1.1 * x), 0.05 * np.sin(0.9 * x)
    scale, bias = 1 + 0.006 * rng.normal(), math.radians(0.15) * rng.normal()
    walk = np.cumsum(rng.normal(size=len(times))) * math.radians(0.05) * math.sqrt(0.02)
    said_yaw = yaw + bias * times + walk
    steps = np.diff(x + 1j * y) * scale * np.exp(1j * (said_yaw - yaw)[1:])
    place = np.concatenate([[0.0], np.cumsum(steps + 2e-4 * (rng.normal(size=300) + 1j * rng.normal(size=300)))])
    rows = []
    for k in range(10, 300, 20):
        inverse = planar(x[k], y[k], yaw[k]).inv()
        for number, pallet in enumerate(pallets):
            seen = turned(level_pose(inverse * pallet.transform()).as_array(), math.radians(turned_deg), shift)
            if abs(seen[0]) < 3.5:
                rng_of = np.random.default_rng((seed, k, number))
                pose = LevelPose(*(seen + SIGMA * rng_of.normal(size=4)).tolist())
                rows.append(PalletMeasurement(times[k], "epal1-1200", pose, np.diag(SIGMA**2), 0.9, YawSource.FACE))
    return Approach(Trajectory(times, place.real, place.imag, said_yaw), tuple(rows))


def turned(pose: FloatArray, angle: float, shift: float) -> FloatArray:
    """Return the pose that a camera sees that is not as its mounting says."""
    off = complex(pose[0], pose[1]) - complex(*CAMERA.translation[:2])
    place = complex(*CAMERA.translation[:2]) + off * complex(math.cos(angle), math.sin(angle)) + shift * 1j
    return np.array([place.real, place.imag, pose[2], wrap_angle(pose[3] + angle)])


def found(given: Approach) -> SeenTurn:
    turn = seen_turn(given.rows, given.odometry, CAMERA)
    assert turn is not None
    return turn


@pytest.mark.parametrize("turned_deg", [-5.0, -2.0, -1.0, 1.0, 2.0, 5.0])
def test_a_turn_is_found_within_its_sigma_and_told(turned_deg: float) -> None:
    turn = found(approach(1, turned_deg))
    assert math.degrees(turn.angle) == pytest.approx(turned_deg, abs=3 * math.degrees(turn.sigma))
    assert math.degrees(turn.sigma) < 0.35
    (line,) = turn_lines(turn)
    assert line.startswith(f"the camera is turned by {-math.degrees(turn.angle):+.2f} degrees of yaw")
    assert f"(sigma {math.degrees(turn.sigma):.2f})" in line
    assert f"a yaw of {-1.2 + turned_deg - turned_deg - math.degrees(turn.angle):.2f} degrees fits" in line


def test_a_mounting_that_is_right_is_never_blamed_and_the_sigma_is_honest() -> None:
    turns = [found(approach(seed)) for seed in range(2, 14)]
    assert not any(turn_lines(turn) for turn in turns)
    scores = np.array([turn.angle / turn.sigma for turn in turns])
    assert np.sqrt((scores**2).mean()) < 1.3
    assert np.abs(scores).max() < 2.6


def test_a_shift_to_the_side_cannot_be_told_and_is_not_taken_for_a_turn() -> None:
    assert turn_lines(found(approach(3, shift=0.06))) == ()


def test_what_is_measured_one_opening_aside_now_and_then_turns_nothing() -> None:
    given = approach(4)
    rows = [
        replace(row, forklift_from_pallet=replace(row.forklift_from_pallet, x=row.forklift_from_pallet.x + 0.4))
        if number % 7 == 3
        else row
        for number, row in enumerate(given.rows)
    ]
    turn = found(replace(given, rows=tuple(rows)))
    assert abs(turn.angle) < 3 * turn.sigma
    assert turn_lines(turn) == ()


def test_a_drive_that_tells_nothing_says_nothing() -> None:
    given = approach(5, 5.0, way=0.05)
    assert seen_turn(given.rows, given.odometry, CAMERA) is None
    assert seen_turn((), given.odometry, CAMERA) is None
    assert seen_turn(given.rows[:2], given.odometry, CAMERA) is None
    elsewhere = replace(given.odometry, times=given.odometry.times + 100)
    assert seen_turn(given.rows, elsewhere, CAMERA) is None


def test_covariances_that_are_none_are_left_out() -> None:
    given = approach(6, 5.0)
    bad = replace(given.rows[0], covariance=np.full((4, 4), 0.0))
    assert math.degrees(found(replace(given, rows=(bad, *given.rows[1:]))).angle) == pytest.approx(5.0, abs=1.0)
