from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras.double_sphere import DoubleSphere
from palletloc.cameras.dual_fisheye import DualFisheye, FisheyeLens
from palletloc.cameras.equirectangular import Equirectangular
from palletloc.cameras.eucm import Eucm
from palletloc.cameras.kannala_brandt import KannalaBrandt
from palletloc.cameras.mei import Mei
from palletloc.cameras.pinhole import Pinhole
from palletloc.cameras.protocol import CameraModel
from palletloc.cameras.stitched_equirectangular import StitchedEquirectangular, StitchedLens
from palletloc.io.camera_spec import (
    angles_from_transform,
    camera_from_spec,
    degrees,
    spec_from_camera,
    transform_from_angles,
)
from palletloc.io.schema import KannalaBrandtSpec, PinholeSpec


def fisheye(cx: float) -> KannalaBrandt:
    return KannalaBrandt(1800, 900, 280.0, 281.0, cx, 449.5, 0.01, -0.002, 3e-4, -1e-5, np.radians(97.5))


CAMERAS: list[CameraModel] = [
    Equirectangular(3840, 1920),
    Pinhole(640, 480, 500.0, 501.0, 320.5, 241.0, -0.1, 0.02, 1e-3, -2e-3, 3e-4),
    fisheye(449.5),
    Mei(1280, 960, 409.0, 410.5, 630.3, 431.9, 1.053, -0.0083, 0.0118, 0.0228, -0.0042, np.radians(105.0)),
    DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566, np.radians(110.0)),
    Eucm(752, 480, 210.0, 211.0, 365.8, 248.9, 0.586, 1.139, np.radians(105.0)),
    DualFisheye(
        FisheyeLens(fisheye(449.5), transform_from_angles((0.02, 0.0, 0.001), (0.5, -0.25, 0.75))),
        FisheyeLens(fisheye(1349.5), transform_from_angles((-0.02, 0.0, 0.0), (1.0, 0.5, 179.5))),
    ),
    StitchedEquirectangular(
        1920,
        960,
        StitchedLens(transform_from_angles((0.02, 0.0, 0.001), (0.5, -0.25, 0.75)), 0.01, -0.002),
        StitchedLens(transform_from_angles((-0.02, 0.0, 0.0), (1.0, 0.5, 179.5))),
    ),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: type(camera).__name__)
def test_a_camera_survives_the_way_to_a_file_and_back(camera: CameraModel) -> None:
    again = camera_from_spec(spec_from_camera(camera))
    assert type(again) is type(camera)
    assert (again.width, again.height) == (camera.width, camera.height)
    points = np.random.default_rng(0).normal(size=(200, 3))
    there, back = camera.project(points), again.project(points)
    assert there.valid.sum() > 5
    np.testing.assert_array_equal(there.valid, back.valid)
    assert_allclose(back.pixels, there.pixels, atol=1e-6)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: type(camera).__name__)
def test_a_description_survives_the_way_to_a_camera_and_back(camera: CameraModel) -> None:
    spec = spec_from_camera(camera)
    assert spec_from_camera(camera_from_spec(spec)) == spec


def test_the_numbers_of_a_pinhole_stand_where_opencv_has_them() -> None:
    spec = PinholeSpec(
        model="pinhole",
        width=640,
        height=480,
        focal_px=(1.0, 2.0),
        center_px=(3.0, 4.0),
        distortion=(0.1, 0.2, 0.3, 0.4, 0.5),
    )
    camera = camera_from_spec(spec)
    assert isinstance(camera, Pinhole)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (1.0, 2.0, 3.0, 4.0)
    assert (camera.k1, camera.k2, camera.p1, camera.p2, camera.k3) == (0.1, 0.2, 0.3, 0.4, 0.5)


def test_numbers_that_describe_no_camera_are_refused() -> None:
    spec = spec_from_camera(fisheye(449.5))
    assert isinstance(spec, KannalaBrandtSpec)
    with pytest.raises(ValueError, match="max_angle"):
        camera_from_spec(spec.model_copy(update={"distortion": (-1.0, 0.0, 0.0, 0.0)}))


def test_a_camera_that_files_do_not_know_is_refused() -> None:
    class Other(Equirectangular):
        pass

    assert spec_from_camera(Other(4, 2)).model == "equirectangular"
    with pytest.raises(ValueError, match="of the kind SimpleNamespace has no form in files"):
        spec_from_camera(cast("CameraModel", SimpleNamespace(width=4, height=2)))


def test_the_rotation_is_yaw_after_pitch_after_roll() -> None:
    roll, pitch, yaw = np.radians([10.0, 20.0, 30.0])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    transform = transform_from_angles((1.0, 2.0, 3.0), (10.0, 20.0, 30.0))
    assert_allclose(transform.as_matrix()[:3, :3], about_z @ about_y @ about_x, atol=1e-12)
    assert_allclose(transform.translation, [1.0, 2.0, 3.0])


angles = st.floats(-180, 180)


@given(st.tuples(angles, angles, angles), st.tuples(*[st.floats(-10, 10)] * 3))
@example((20.0, 90.0, 30.0), (0.0, 0.0, 0.0))
@example((20.0, -90.0, 30.0), (0.0, 0.0, 0.0))
def test_a_transform_survives_the_way_to_angles_and_back(
    roll_pitch_yaw: tuple[float, float, float], translation: tuple[float, float, float]
) -> None:
    rotation = Rotation.from_euler("xyz", roll_pitch_yaw, degrees=True)
    transform = RigidTransform.from_components(translation, rotation)
    again = transform_from_angles(*angles_from_transform(transform))
    assert_allclose(again.as_matrix(), transform.as_matrix(), atol=2e-7)


@given(st.integers(-180_000, 180_000))
def test_degrees_of_typed_angles_are_the_typed_ones(thousandths: int) -> None:
    assert degrees(float(np.radians(thousandths / 1000))) == thousandths / 1000
