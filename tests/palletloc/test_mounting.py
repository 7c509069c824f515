from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.mounting import Mounting

STEP = 1e-6
POINTS = np.random.default_rng(0).uniform(-4.0, 4.0, (20, 3))
Mounted = Callable[..., RigidTransform]


@pytest.fixture
def mounting(mounted: Mounted) -> Mounting:
    return Mounting(mounted(0.3, -0.1, 1.8, 40.0, 12.0, -5.0), (0.001, 0.002, 0.003), (0.01, 0.02, 0.03))


def assumed(true: RigidTransform, errors: np.ndarray) -> RigidTransform:
    """The mounting moved along and turned about the forklift's axes."""
    turn = Rotation.from_rotvec(errors[3:]) * true.rotation
    return RigidTransform.from_components(true.translation + errors[:3], turn)


def test_points_seem_to_move_as_they_do_with_a_wrong_mounting(mounting: Mounting) -> None:
    true = mounting.forklift_from_camera
    points_camera = true.inv().apply(POINTS)
    motion = mounting.apparent_motion(POINTS)
    assert motion.shape == (20, 3, 6)
    for k, errors in enumerate(STEP * np.eye(6)):
        moved = assumed(true, errors).apply(points_camera) - assumed(true, -errors).apply(points_camera)
        np.testing.assert_allclose(motion[:, :, k], moved / (2 * STEP), atol=1e-6)


def test_the_camera_itself_is_where_turns_leave_everything(mounting: Mounting) -> None:
    motion = mounting.apparent_motion(mounting.center[None])
    np.testing.assert_allclose(motion[0], np.eye(3, 6), atol=1e-12)


def test_its_center_is_the_cameras_origin(mounting: Mounting) -> None:
    np.testing.assert_allclose(mounting.center, [0.3, -0.1, 1.8])
    np.testing.assert_allclose(mounting.forklift_from_camera.apply(np.zeros(3)), mounting.center)


def test_sigmas_are_translations_before_rotations(mounting: Mounting) -> None:
    np.testing.assert_array_equal(mounting.sigma, [0.001, 0.002, 0.003, 0.01, 0.02, 0.03])
