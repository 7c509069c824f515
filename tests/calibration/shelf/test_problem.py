from dataclasses import replace

import numpy as np
import pytest

from calibration.drive import Drive, compose, relative
from calibration.shelf.pallets import PalletObservation
from calibration.shelf.problem import EdgeObservation, Observed, same_pallets, solve
from palletloc.geometry import FloatArray, LevelPose, wrap_angle

CAMERA = np.array([0.3, -0.1])
PALLETS = np.array([[1.0, 2.0, 1.57], [2.5, 2.05, 1.60], [4.0, 1.98, 1.55]])
EDGES = np.array([[0.2, 1.95], [2.9, 1.95], [2.95, 2.02], [4.8, 1.96]])
BEARING_SIGMA = 0.0004


def way(count: int = 12) -> FloatArray:
    """Return true poses: 3 m along a slight S."""
    along = np.linspace(0, 3, count)
    return np.stack([along, 0.03 * np.sin(2 * along), 0.06 * np.cos(2 * along) - 0.06], axis=1)


def observed(seed: int = 0, *, scale: float = 1.0, bias: float = 0.0, yaw: float = 0.0) -> Observed:
    """Return what is seen along the way, with noise and with the given constant errors."""
    rng = np.random.default_rng(seed)
    poses = way()
    durations = np.concatenate([[0.0], np.full(len(poses) - 1, 0.5)])
    before = np.concatenate([poses[:1], poses[:-1]])
    drive = Drive(
        LevelPose(float(poses[0, 0]), float(poses[0, 1]), 0.0, float(poses[0, 2])), relative(before, poses), durations
    )
    steps = drive.corrected(1 / scale, -bias) + 0.3 * drive.sigma * rng.standard_normal(drive.steps.shape)
    drive = Drive(drive.start, steps, durations)
    covariance = np.diag([0.002, 0.002, 0.002]) ** 2
    center = np.array([*CAMERA, 0.0])
    sights, owner, bearings = [], [], []
    for shot, pose in enumerate(poses):
        for i, pallet in enumerate(PALLETS):
            seen = compose(np.array([*CAMERA, yaw]), relative(pose, pallet) - center)
            seen = seen + rng.multivariate_normal(np.zeros(3), covariance)
            level = LevelPose(float(seen[0]), float(seen[1]), 0.0, float(seen[2]))
            sights.append(PalletObservation(shot, "m", level, covariance))
            owner.append(i)
        for i, edge in enumerate(EDGES):
            x, y, _ = relative(pose, np.array([*edge, 0.0])) - center
            azimuth = float(np.arctan2(y, x)) + yaw + BEARING_SIGMA * rng.standard_normal()
            bearings.append(EdgeObservation(shot, i, azimuth, BEARING_SIGMA))
    return Observed(drive, CAMERA, tuple(sights), np.array(owner), tuple(bearings))


def test_poses_and_landmarks_are_found_although_the_odometry_is_off() -> None:
    seen = observed(1, scale=1.012, bias=-0.006)
    assert np.abs(seen.drive.poses() - way()).max() > 0.03
    found = solve(seen, EDGES + 0.02)
    assert np.abs(found.poses[:, :2] - way()[:, :2]).max() < 0.006
    assert np.abs(wrap_angle(found.poses[:, 2] - way()[:, 2])).max() < 0.002
    assert np.abs(found.edges - EDGES).max() < 0.008
    assert np.abs(found.pallets - PALLETS).max() < 0.008
    assert found.scale == pytest.approx(1.012, abs=0.004)
    assert found.bias == pytest.approx(-0.006, abs=0.001)


@pytest.mark.slow
def test_errors_stay_within_what_the_covariance_says() -> None:
    squares = []
    for seed in range(12):
        found = solve(observed(seed, scale=1.008, bias=0.004), EDGES)
        covariance = found.landmark_covariance()[1]
        off = (found.edges - EDGES).ravel()
        squares.append(off @ np.linalg.solve(covariance, off) / len(off))
    assert 0.05 < np.mean(squares) < 1.3  # pallets are taken for less sure than they state


def test_one_wrong_pallet_does_not_move_the_edges() -> None:
    right = observed(2)
    wrong = list(right.pallets)
    wrong[7] = replace(wrong[7], pose=replace(wrong[7].pose, x=wrong[7].pose.x + 0.2))
    moved = solve(replace(right, pallets=tuple(wrong)), EDGES)
    assert np.abs(moved.edges - solve(right, EDGES).edges).max() < 0.004


def test_a_turned_camera_is_found_where_it_is_asked_for() -> None:
    seen = observed(3, yaw=0.02)
    found = solve(seen, EDGES, yaw_sigma=0.05)
    sigma = 0.05 * float(np.sqrt(found.covariance[2, 2]))
    assert found.yaw == pytest.approx(0.02, abs=3 * sigma)
    assert sigma < 0.008
    assert solve(seen, EDGES).yaw == 0.0


def test_sights_of_one_pallet_are_joined_in_spite_of_drift() -> None:
    seen = observed(4, bias=0.01)
    sights, owner = same_pallets(seen.drive, seen.pallets[::-1])
    assert len(sights) == len(seen.pallets)
    places = np.array([compose(way()[sight.shot], sight.planar)[:2] for sight in sights])
    for i in range(3):
        assert np.ptp(places[owner == i], axis=0).max() < 0.1
    assert np.unique(owner).tolist() == [0, 1, 2]


def test_a_pallet_that_is_seen_once_counts_for_nothing() -> None:
    seen = observed(4)
    lone = PalletObservation(0, "m", LevelPose(9.0, 2.0, 0.0, 1.57), np.eye(3) * 1e-6)
    sights, owner = same_pallets(seen.drive, [*seen.pallets, lone])
    assert lone not in sights
    assert owner.max() == 2
