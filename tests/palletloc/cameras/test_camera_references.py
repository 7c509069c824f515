import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole, RationalPinhole
from palletloc.geometry import FloatArray
from tests.palletloc.cameras.sample_cameras import (
    DUAL,
    FISHEYE_TERMS,
    FULL_SPHERE,
    PINHOLES,
    RATIONALS,
    image_pixels,
    opencv_points,
    random_points,
)


def camera_matrix(camera: KannalaBrandt | Pinhole | RationalPinhole) -> FloatArray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


class TestEquirectangular:
    CAMERA = Equirectangular(3840, 1920)

    def test_follows_the_stated_convention(self) -> None:
        for u, v in [(0, 0), (17.25, 1200.5), (1919.5, 959.5), (3839, 1919)]:
            lon = math.pi - 2 * math.pi * (u + 0.5) / 3840
            lat = math.pi / 2 - math.pi * (v + 0.5) / 1920
            ray = (math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat))
            np.testing.assert_allclose(self.CAMERA.project(np.array(ray)).pixels, [u, v], atol=1e-9)

    def test_repeats_after_its_period(self) -> None:
        period = self.CAMERA.period_px
        assert period == 3840
        pixels = image_pixels(self.CAMERA, 100.0)
        turns = self.CAMERA.unproject(pixels + np.array([2 * period, 0.0])).directions
        np.testing.assert_allclose(turns, self.CAMERA.unproject(pixels).directions, atol=1e-14)

    def test_sees_everything(self) -> None:
        assert self.CAMERA.project(random_points(10_000)).valid.all()
        poles = self.CAMERA.project(np.array([[0, 0, 1.0], [0, 0, -1.0]]))
        assert poles.valid.all()
        np.testing.assert_allclose(poles.pixels[:, 1], [-0.5, 1919.5])

    def test_agrees_with_py360convert(self) -> None:
        utils = pytest.importorskip("py360convert.utils")
        points = random_points(5_000)
        # py360convert: x right, y up, z forward; pixel centres at integers, as here.
        lon, lat = utils.xyz2uv(np.stack([-points[:, 1], points[:, 2], points[:, 0]], axis=-1))
        theirs = np.concatenate(utils.uv2coor(lon, lat, 1920, 3840), axis=-1)
        np.testing.assert_allclose(self.CAMERA.project(points).pixels, theirs, atol=1e-9)

    def test_agrees_with_pycolmap_up_to_half_a_pixel(self) -> None:
        pycolmap = pytest.importorskip("pycolmap")
        if "EQUIRECTANGULAR" not in pycolmap.CameraModelId.__members__:
            pytest.skip("this pycolmap has no equirectangular camera")
        camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=3840, height=1920, params=[3840, 1920])
        points = random_points(5_000)
        # pycolmap: x right, y down, z forward; the first pixel's centre is at 0.5.
        theirs = camera.img_from_cam(opencv_points(points))
        np.testing.assert_allclose(self.CAMERA.project(points).pixels + 0.5, theirs, atol=1e-9)

    def test_refuses_an_image_without_pixels(self) -> None:
        for size in ((0, 10), (10, -1)):
            with pytest.raises(ValueError, match="positive width and height"):
                Equirectangular(*size)


class TestKannalaBrandt:
    CAMERA = KannalaBrandt(1000, 1000, 200.0, 205.0, 498.0, 503.0, **FISHEYE_TERMS, max_angle=np.radians(115.0))

    @pytest.mark.parametrize("angle_deg", [1.0, 45.0, 89.0, 90.0, 91.0, 100.0, 114.9])
    @pytest.mark.parametrize("around_deg", [0.0, 35.0, 90.0, 200.0, 315.0])
    def test_follows_the_polynomial_beyond_90_degrees(self, angle_deg: float, around_deg: float) -> None:
        angle, around = math.radians(angle_deg), math.radians(around_deg)
        radius = sum(k * angle**power for k, power in zip((1, *FISHEYE_TERMS.values()), (1, 3, 5, 7, 9), strict=True))
        right, down = math.cos(around), math.sin(around)
        ray = np.array([math.cos(angle), -math.sin(angle) * right, -math.sin(angle) * down])
        pixel = np.array([498.0 + 200.0 * radius * right, 503.0 + 205.0 * radius * down])
        projection = self.CAMERA.project(2.7 * ray)
        assert projection.valid
        np.testing.assert_allclose(projection.pixels, pixel, atol=1e-9)
        np.testing.assert_allclose(self.CAMERA.unproject(pixel).directions, ray, atol=1e-12)

    def test_sees_up_to_its_largest_angle(self) -> None:
        angles = np.radians([114.999, 115.001])
        rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(2)], axis=-1)
        np.testing.assert_array_equal(self.CAMERA.project(rays).valid, [True, False])

    def test_straight_behind_is_nowhere_even_for_a_full_sphere(self) -> None:
        behind = np.array([[-1.0, 0, 0], [-1.0, 1e-9, 0]])
        np.testing.assert_array_equal(FULL_SPHERE.project(behind).valid, [False, True])

    def test_agrees_with_opencv_within_80_degrees(self) -> None:
        points = random_points(20_000)
        points = points[points[:, 0] > np.cos(np.radians(80)) * np.linalg.norm(points, axis=-1)]
        terms = np.array(list(FISHEYE_TERMS.values()))
        seen = opencv_points(points)[:, None]
        theirs, _ = cv2.fisheye.projectPoints(seen, np.zeros(3), np.zeros(3), camera_matrix(self.CAMERA), terms)
        ours = self.CAMERA.project(points)
        assert ours.valid.all()
        np.testing.assert_allclose(ours.pixels, np.asarray(theirs)[:, 0], atol=1e-8)

    @given(st.tuples(*[st.floats(-0.05, 0.05)] * 4), st.floats(0.1, np.pi))
    def test_accepts_exactly_what_can_be_inverted(
        self, k: tuple[float, float, float, float], max_angle: float
    ) -> None:
        angles = np.linspace(0, max_angle, 2000)
        radii = angles * np.polyval([*reversed(k), 1.0], angles**2)
        slopes = np.diff(radii) / np.diff(angles)
        try:
            camera = KannalaBrandt(6000, 6000, 100.0, 100.0, 3000.0, 3000.0, *k, max_angle=max_angle)
        except ValueError:
            assert slopes.min() < 1e-2
            return
        assert slopes.min() > 0
        pixels = np.stack([3000.0 + 100.0 * radii[:-1], np.full(len(radii) - 1, 3000.0)], axis=-1)
        rays = camera.unproject(pixels[pixels[:, 0] < 5999])
        assert rays.valid.all()
        found = np.arctan2(-rays.directions[:, 1], rays.directions[:, 0])
        expected = angles[:-1][pixels[:, 0] < 5999]
        slope = np.gradient(radii, angles)[:-1][pixels[:, 0] < 5999]
        assert (np.abs(found - expected) * np.maximum(slope, 1e-3)).max() < 1e-9


class TestPinhole:
    @pytest.mark.parametrize("name", PINHOLES)
    def test_agrees_with_opencv(self, name: str) -> None:
        camera = PINHOLES[name]
        points = random_points(20_000)
        ours = camera.project(points)
        assert ours.valid.sum() > 1000
        terms = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
        seen = opencv_points(points[ours.valid])
        theirs, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera_matrix(camera), terms)
        np.testing.assert_allclose(ours.pixels[ours.valid], np.asarray(theirs)[:, 0], atol=1e-8)

    @pytest.mark.parametrize("name", RATIONALS)
    def test_a_rational_one_agrees_with_opencv(self, name: str) -> None:
        camera = RATIONALS[name]
        points = random_points(20_000)
        ours = camera.project(points)
        assert ours.valid.sum() > 1000
        terms = np.array([getattr(camera, term) for term in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")])
        seen = opencv_points(points[ours.valid])
        theirs, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera_matrix(camera), terms)
        np.testing.assert_allclose(ours.pixels[ours.valid], np.asarray(theirs)[:, 0], atol=1e-8)

    def test_does_not_see_behind(self) -> None:
        assert not PINHOLES["pinhole"].project(np.array([[-1.0, 0, 0], [0.0, 0.1, 0.1], [0.0, 0, 0.1]])).valid.any()

    def test_does_not_see_what_the_distortion_folds_back_into_the_image(self) -> None:
        camera = Pinhole(1000, 1000, 400.0, 400.0, 499.5, 499.5, k1=-0.3)
        # r - 0.3 r^3 turns back at r = 1 / sqrt(0.9).
        turn = 1 / math.sqrt(0.9)
        radii = np.array([0.5, turn - 1e-6, turn + 1e-6, 1.5])
        points = np.stack([np.ones(4), -radii, np.zeros(4)], axis=-1)
        np.testing.assert_array_equal(camera.project(points).valid, [True, True, False, False])
        reach = 400.0 * (turn - 0.3 * turn**3)
        beyond = camera.unproject(np.array([[499.5 + reach - 1e-6, 499.5], [499.5 + reach + 1e-6, 499.5]]))
        np.testing.assert_array_equal(beyond.valid, [True, False])

    def test_no_two_directions_share_a_pixel(self) -> None:
        camera = PINHOLES["brown_folding"]
        points = random_points(50_000)
        projection = camera.project(points)
        seen = points[projection.valid]
        rays = camera.unproject(projection.pixels[projection.valid])
        cosines = (seen * rays.directions).sum(axis=-1) / np.linalg.norm(seen, axis=-1)
        assert cosines.min() > 1 - 1e-12


class TestDualFisheye:
    def test_each_axis_hits_the_centre_of_its_lens(self) -> None:
        for lens in (DUAL.front, DUAL.back):
            point = lens.camera_from_lens.apply(np.array([1.5, 0.0, 0.0]))
            np.testing.assert_allclose(DUAL.project(point).pixels, [lens.model.cx, lens.model.cy], atol=1e-9)
            np.testing.assert_allclose(DUAL.centers(point), lens.camera_from_lens.translation)

    def test_a_point_is_projected_by_the_lens_whose_axis_is_nearer(self) -> None:
        points = random_points(5_000)
        angles = []
        images = []
        for lens in (DUAL.front, DUAL.back):
            axis = lens.camera_from_lens.rotation.apply([1.0, 0.0, 0.0])
            angles.append(np.arccos(points @ axis / np.linalg.norm(points, axis=-1)))
            images.append(lens.model.project(lens.camera_from_lens.inv().apply(points)).pixels)
        nearer = np.argmin(angles, axis=0)
        expected = np.stack(images, axis=1)[np.arange(len(points)), nearer]
        projection = DUAL.project(points)
        assert projection.valid.mean() > 0.99
        assert 0.3 < nearer.mean() < 0.7
        np.testing.assert_allclose(projection.pixels[projection.valid], expected[projection.valid], atol=1e-9)

    def test_distance_counts_because_the_centres_differ(self) -> None:
        point = np.array([1.0, 0.8, 0.3])
        near, far = DUAL.project(np.stack([point, 1000 * point])).pixels
        # The front lens is 12 mm ahead of the camera's origin, some 40 degrees off this point: 2.3 px.
        assert 1.0 < np.linalg.norm(near - far) < 4.0

    def test_pixels_between_and_beyond_the_circles_see_nothing(self) -> None:
        rays = DUAL.unproject(np.array([[2.0, 2.0], [960.0, 20.0], [1917.0, 950.0]]))
        assert not rays.valid.any()

    def test_does_not_see_the_origin_even_between_its_lenses(self) -> None:
        lenses = [
            FisheyeLens(
                lens.model, RigidTransform.from_components([0.0, offset, 0.0], lens.camera_from_lens.rotation)
            )
            for lens, offset in ((DUAL.front, 0.02), (DUAL.back, -0.02))
        ]
        points = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0]])
        np.testing.assert_array_equal(DualFisheye(*lenses).project(points).valid, [False, True])

    def test_refuses_lenses_that_cannot_be_told_apart_or_have_different_images(self) -> None:
        for back in (DUAL.front, FisheyeLens(DUAL.front.model, DUAL.back.camera_from_lens)):
            with pytest.raises(ValueError, match="must differ in their axis"):
                DualFisheye(DUAL.front, back)
        small = KannalaBrandt(960, 960, 280.0, 280.0, 480.0, 480.0)
        with pytest.raises(ValueError, match="whole image, got 1920 x 960 and 960 x 960"):
            DualFisheye(DUAL.front, FisheyeLens(small, DUAL.back.camera_from_lens))
