from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.mounting import Mounting

Mounted = Callable[..., RigidTransform]


@pytest.fixture
def mounting(mounted: Mounted) -> Mounting:
    return Mounting(mounted(0.3, -0.1, 1.8, 40.0, 12.0, -5.0), (0.001, 0.002, 0.003), (0.01, 0.02, 0.03))


def test_its_center_is_the_cameras_origin(mounting: Mounting) -> None:
    np.testing.assert_allclose(mounting.center, [0.3, -0.1, 1.8])
    np.testing.assert_allclose(mounting.forklift_from_camera.apply(np.zeros(3)), mounting.center)


def test_sigmas_are_translations_before_rotations(mounting: Mounting) -> None:
    np.testing.assert_array_equal(mounting.sigma, [0.001, 0.002, 0.003, 0.01, 0.02, 0.03])


def test_its_inverse_comes_as_a_matrix_and_as_a_transform_and_cannot_be_changed(mounting: Mounting) -> None:
    inverse = mounting.forklift_from_camera.inv().as_matrix()
    np.testing.assert_allclose(mounting.camera_from_forklift, inverse, atol=1e-15)
    np.testing.assert_allclose(mounting.to_camera.as_matrix(), inverse, atol=1e-15)
    assert not mounting.center.flags.writeable
    assert not mounting.camera_from_forklift.flags.writeable
