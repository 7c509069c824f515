"""The unified models against their definitions, written down a second time, and against each other."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import (
    CameraModel,
    DoubleSphere,
    Equirectangular,
    Eucm,
    KannalaBrandt,
    Mei,
    Pinhole,
    StitchedEquirectangular,
    StitchedLens,
)
from tests.palletloc.cameras.sample_cameras import opencv_points, random_points

TURNED = RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True))


def test_a_stitcher_that_was_right_leaves_the_panorama_as_it_is() -> None:
    camera = StitchedEquirectangular(800, 400, StitchedLens(RigidTransform.identity()), StitchedLens(TURNED))
    plain, points = Equirectangular(800, 400), random_points(3000)
    ours = camera.project(points)
    assert ours.valid.mean() > 0.999
    np.testing.assert_allclose(ours.pixels[ours.valid], plain.project(points).pixels[ours.valid], atol=1e-9)
    pixels = plain.project(points).pixels
    np.testing.assert_allclose(camera.unproject(pixels).directions, plain.unproject(pixels).directions, atol=1e-12)


def test_each_lens_sees_from_its_own_centre() -> None:
    front = RigidTransform.from_translation([0.02, 0.0, 0.0])
    back = RigidTransform.from_components([-0.02, 0.0, 0.0], TURNED.rotation)
    camera = StitchedEquirectangular(800, 400, StitchedLens(front), StitchedLens(back))
    points = random_points(2000)
    offset = np.where(points[:, :1] >= 0, [[0.02, 0, 0]], [[-0.02, 0, 0]])
    np.testing.assert_allclose(camera.centers(points), offset)
    ours = camera.project(points)
    expected = Equirectangular(800, 400).project(points - offset).pixels
    np.testing.assert_allclose(ours.pixels[ours.valid], expected[ours.valid], atol=1e-9)


def test_a_bend_moves_points_along_the_way_from_the_axis() -> None:
    lens = StitchedLens(RigidTransform.identity(), k1=0.01, k2=-0.002)
    camera = StitchedEquirectangular(3600, 1800, lens, StitchedLens(TURNED))
    for angle in np.radians([10.0, 45.0, 80.0]):
        column = camera.project(np.array([np.cos(angle), -np.sin(angle), 0.0])).pixels[0]
        placed = angle * (1 + 0.01 * angle**2 - 0.002 * angle**4)
        assert column == pytest.approx(1799.5 + 10 * np.degrees(placed))


def test_refuses_what_is_no_pair_of_lenses() -> None:
    front = StitchedLens(RigidTransform.identity())
    with pytest.raises(ValueError, match="must differ in their axis"):
        StitchedEquirectangular(200, 100, front, front)
    with pytest.raises(ValueError, match="the back lens folds"):
        StitchedEquirectangular(200, 100, front, StitchedLens(TURNED, k1=-0.3))
    with pytest.raises(ValueError, match="positive width"):
        StitchedEquirectangular(0, 100, front, StitchedLens(TURNED))


ONE_LENS = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses/one_lens"


def test_mei_without_xi_is_a_pinhole() -> None:
    terms = (-0.2, 0.05, 0.001, -0.002)
    points = random_points(5000)
    pinhole = Pinhole(800, 600, 500.0, 505.0, 401.0, 299.0, *terms).project(points)
    mei = Mei(800, 600, 500.0, 505.0, 401.0, 299.0, 0.0, *terms).project(points)
    assert pinhole.valid.sum() > 500
    np.testing.assert_array_equal(mei.valid, pinhole.valid)
    np.testing.assert_allclose(mei.pixels, pinhole.pixels, atol=1e-9)


def test_double_sphere_and_eucm_meet_mei_where_they_are_the_unified_model() -> None:
    xi = 0.8
    points = random_points(5000)
    mei = Mei(900, 900, 180.0 * (1 + xi), 181.0 * (1 + xi), 450.0, 449.0, xi).project(points)
    alpha = xi / (1 + xi)
    for camera in (
        DoubleSphere(900, 900, 180.0, 181.0, 450.0, 449.0, 0.0, alpha),
        Eucm(900, 900, 180.0, 181.0, 450.0, 449.0, alpha, 1.0),
    ):
        other = camera.project(points)
        np.testing.assert_array_equal(other.valid, mei.valid)
        np.testing.assert_allclose(other.pixels, mei.pixels, atol=1e-9)
    assert mei.valid.sum() > 2000


def test_double_sphere_follows_its_two_spheres() -> None:
    camera = DoubleSphere(2000, 2000, 300.0, 302.0, 1000.0, 999.0, -0.25, 0.6)
    points = random_points(2000)
    x, y, z = opencv_points(points / np.linalg.norm(points, axis=-1, keepdims=True)).T
    second = np.stack([x, y, z - 0.25], axis=-1)
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    # Seen from alpha / (1 - alpha) behind the second sphere's centre.
    depth = second[:, 2] + 1.5
    pixels = np.stack([300.0 * second[:, 0] / depth, 302.0 * second[:, 1] / depth], axis=-1) / 0.4
    projection = camera.project(points)
    assert projection.valid.sum() > 1000
    np.testing.assert_allclose(
        projection.pixels[projection.valid], pixels[projection.valid] + (1000.0, 999.0), atol=1e-9
    )


def test_eucm_agrees_with_pycolmap_up_to_half_a_pixel() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    if "EUCM" not in pycolmap.CameraModelId.__members__:
        pytest.skip("this pycolmap has no EUCM camera")
    params = [240.0, 242.0, 498.0, 483.0, 0.58, 1.14]
    theirs = pycolmap.Camera(model="EUCM", width=1000, height=960, params=params)
    points = random_points(5000)
    points = points[points[:, 0] > 0.05]
    ours = Eucm(1000, 960, 240.0, 242.0, 497.5, 482.5, 0.58, 1.14).project(points)
    assert ours.valid.sum() > 1000
    expected = np.asarray(theirs.img_from_cam(opencv_points(points)))
    np.testing.assert_allclose(ours.pixels[ours.valid] + 0.5, expected[ours.valid], atol=1e-9)


@pytest.mark.parametrize(
    ("camera", "limit_deg"),
    [
        (Mei(8000, 8000, 900.0, 900.0, 4000.0, 4000.0, 2.0), 120.0),  # cos = -1 / xi
        (Mei(8000, 8000, 2.0, 2.0, 4000.0, 4000.0, 0.5), 120.0),  # cos = -xi
        (Eucm(8000, 8000, 900.0, 900.0, 4000.0, 4000.0, 2 / 3, 1.0), 120.0),
        (DoubleSphere(8000, 8000, 900.0, 900.0, 4000.0, 4000.0, 0.0, 2 / 3), 120.0),
        (DoubleSphere(8000, 8000, 900.0, 900.0, 4000.0, 4000.0, 2.0, 0.0), 120.0),
    ],
)
def test_nothing_is_seen_beyond_the_models_own_limit(camera: CameraModel, limit_deg: float) -> None:
    angles = np.radians([limit_deg - 0.2, limit_deg + 0.2, 175.0])
    projection = camera.project(np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=-1))
    np.testing.assert_array_equal(projection.valid, [True, False, False])
    assert np.isnan(projection.pixels[1:]).all()


@pytest.mark.parametrize("kind", [Mei, DoubleSphere, Eucm])
def test_sees_up_to_the_stated_angle(kind: Any) -> None:
    shape = {Mei: (1.0,), DoubleSphere: (-0.2, 0.55), Eucm: (0.58, 1.1)}[kind]
    camera = kind(4000, 4000, 300.0, 300.0, 2000.0, 2000.0, *shape, max_angle=math.radians(101.0))
    angles = np.radians([100.999, 101.001])
    rays = np.stack([np.cos(angles), np.zeros(2), np.sin(angles)], axis=-1)
    np.testing.assert_array_equal(camera.project(rays).valid, [True, False])


@pytest.mark.parametrize(
    ("kind", "shape", "message"),
    [
        (KannalaBrandt, {"max_angle": np.radians(130.0), "k1": -0.1}, "stops growing at 1.8257 rad"),
        (KannalaBrandt, {"max_angle": 0.0}, r"in \(0, pi\]"),
        (KannalaBrandt, {"max_angle": 3.2}, r"in \(0, pi\]"),
        (KannalaBrandt, {"max_angle": math.nan}, "finite"),
        (KannalaBrandt, {"k3": math.inf}, "finite"),
        (KannalaBrandt, {"fx": 0.0}, "focal lengths"),
        (KannalaBrandt, {"width": 0}, "positive width"),
        (Pinhole, {"fy": -1.0}, "focal"),
        (Pinhole, {"p1": math.nan}, "finite"),
        (Mei, {"xi": -0.1}, "xi must not be negative"),
        (Mei, {"xi": 1.0, "k1": math.nan}, "finite"),
        (Mei, {"xi": 1.0, "max_angle": 3.2}, r"in \(0, pi\]"),
        (DoubleSphere, {"xi": -1.0, "alpha": 0.5}, "above -1"),
        (DoubleSphere, {"xi": 0.0, "alpha": 1.1}, "between 0 and 1"),
        (Eucm, {"alpha": -0.1, "beta": 1.0}, "between 0 and 1"),
        (Eucm, {"alpha": 0.5, "beta": 0.0}, "beta must be positive"),
        (Eucm, {"alpha": 0.5, "beta": 1.0, "fx": 0.0}, "focal lengths"),
    ],
)
def test_refuses_what_is_no_lens(kind: Any, shape: dict[str, float], message: str) -> None:
    lens: dict[str, Any] = {"width": 100, "height": 100, "fx": 30.0, "fy": 30.0, "cx": 50.0, "cy": 50.0}
    with pytest.raises(ValueError, match=message):
        kind(**{**lens, **shape})


@pytest.mark.skipif(not ONE_LENS.is_dir(), reason="the calibrations are not there")
def test_one_real_lens_is_the_same_in_three_models() -> None:
    cameras: list[CameraModel] = []
    for name, kind in (("DS", DoubleSphere), ("EUCM", Eucm), ("KB", KannalaBrandt)):
        parameters: dict[str, Any] = yaml.safe_load((ONE_LENS / f"{name}.yml").read_text())["parameter"]
        cameras.append(kind(752, 480, **parameters))
    u, v = np.meshgrid(np.arange(100, 650, 25.0), np.arange(50, 430, 25.0))
    rays = [camera.unproject(np.stack([u, v], axis=-1)).directions for camera in cameras]
    # Their centres differ by a pixel: up to a common rotation they agree to a few hundredths of a degree.
    for other in rays[1:]:
        left, _, right = np.linalg.svd(np.einsum("abi,abj->ij", rays[0], other))
        turned = other @ (left @ right).T
        assert np.degrees(np.linalg.norm(rays[0] - turned, axis=-1)).max() < 0.1
