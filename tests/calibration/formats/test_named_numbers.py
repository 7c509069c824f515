"""Cameras whose numbers have names; the truth is COLMAP itself, and the formulas of the others' documentation."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.formats.any_format import read_cameras
from calibration.formats.ocam import OcamCamera
from palletloc.cameras import CameraModel, Equirectangular, Eucm, KannalaBrandt, Mei, Pinhole
from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray
from tests.calibration.expecting import Calibrate
from tests.calibration.formats.texts import CAMODOCAL, MEI, SCARAMUZZA, Written, metashape, pixels_of, rays_of

COLMAP = {
    "SIMPLE_PINHOLE": (700.0, 405.0, 296.0),
    "PINHOLE": (700.0, 702.0, 405.0, 296.0),
    "SIMPLE_RADIAL": (700.0, 405.0, 296.0, -0.08),
    "RADIAL": (700.0, 405.0, 296.0, -0.08, 0.02),
    "OPENCV": (700.0, 702.0, 405.0, 296.0, -0.08, 0.02, 0.001, -0.002),
    "FULL_OPENCV": (700.0, 702.0, 405.0, 296.0, 0.3, -0.1, 0.001, -0.002, 0.02, 0.4, -0.03, 0.01),
    "FOV": (500.0, 502.0, 405.0, 296.0, 0.8),
    "SIMPLE_FISHEYE": (300.0, 405.0, 296.0),
    "FISHEYE": (300.0, 302.0, 405.0, 296.0),
    "SIMPLE_RADIAL_FISHEYE": (300.0, 405.0, 296.0, 0.01),
    "RADIAL_FISHEYE": (300.0, 405.0, 296.0, 0.01, -0.003),
    "OPENCV_FISHEYE": (300.0, 302.0, 405.0, 296.0, 0.01, -0.003, 0.0005, -0.0001),
    "THIN_PRISM_FISHEYE": (300.0, 302.0, 405.0, 296.0, 0.01, -0.003, 1e-4, -2e-4, 5e-4, -1e-4, 1e-4, -5e-5),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *(300.0, 302.0, 405.0, 296.0, 0.01, -0.003, 5e-4, -1e-4, 1e-5, -1e-6),
        *(1e-4, -2e-4, 1e-4, 1e-5, -1e-4, 2e-5),
    ),
    "SIMPLE_DIVISION": (600.0, 405.0, 296.0, -0.15),
    "DIVISION": (600.0, 602.0, 405.0, 296.0, -0.15),
    "EUCM": (300.0, 302.0, 405.0, 296.0, 0.6, 1.1),
}
NEARLY = {"FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION"}


class TestColmap:
    @pytest.mark.parametrize("model", COLMAP)
    def test_every_model_images_as_in_colmap(self, read: Written, model: str) -> None:
        pycolmap = pytest.importorskip("pycolmap")
        if model not in pycolmap.CameraModelId.__members__:
            pytest.skip("this pycolmap does not know the model")
        numbers = " ".join(str(number) for number in COLMAP[model])
        camera = read(f"# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n7 {model} 800 600 {numbers}\n")
        theirs = pycolmap.Camera(model=model, width=800, height=600, params=list(COLMAP[model]))
        rays = rays_of(camera)
        rays = rays[rays[:, 2] > 0.1]
        # The middle of the first pixel is at (0.5, 0.5) there.
        off = np.linalg.norm(pixels_of(camera, rays) + 0.5 - theirs.img_from_cam(rays), axis=-1)
        assert off.max() < (0.5 if model in NEARLY else 1e-8)

    def test_the_centre_of_an_image_is_its_middle_pixel(self, read: Written) -> None:
        camera = read("1 OPENCV_FISHEYE 1920 1080 900 900 960 540 0.01 -0.001 0 0\n")
        assert isinstance(camera, KannalaBrandt)
        assert (camera.fx, camera.cx, camera.cy, camera.k1, camera.k2) == (900, 959.5, 539.5, 0.01, -0.001)

    def test_half_a_pixel_is_told(self, tmp_path: Path) -> None:
        (tmp_path / "c").write_text("1 PINHOLE 1920 1080 900 900 960 540\n")
        assert "half a pixel less" in read_cameras(tmp_path / "c")[0].note

    def test_panoramas_have_no_lens(self, read: Written) -> None:
        assert read("1 EQUIRECTANGULAR 3840 1920 3840 1920\n") == Equirectangular(3840, 1920)
        with pytest.raises(PalletLocError, match="line 1: is a panorama of 3840 x 1900 px"):
            read("1 EQUIRECTANGULAR 3840 1900 3840 1900\n")

    def test_cameras_have_no_places(self, tmp_path: Path, calibrate: Calibrate) -> None:
        path = tmp_path / "cameras.txt"
        path.write_text("# Camera list\n1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 510 500 320 240\n")
        arguments = "convert", path, "--out", tmp_path / "o.yaml", "--to"
        calibrate(*arguments, "kalibr").refuses("does not say where its 2 cameras are against each other")
        assert calibrate(*arguments, "palletloc", "--camera", 1).code == 0
        assert yaml.safe_load((tmp_path / "o.yaml").read_text())["camera"]["focal_px"] == [510, 500]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("1 OPENCV 640 480 500 500 320\n", "line 1: expected the 8 numbers fx, fy, cx, cy, k1, k2, p1, p2 of"),
            ("\n1 OPENCW 640 480 500 500 320 240\n", "line 2: unknown camera model 'OPENCW'; did you mean 'OPENCV'"),
            ("1 PINHOLE 640 480 500 500 320 1e999\n", "line 1.cy: expected a finite number"),
            ("1 PINHOLE 0 480 500 500 320 240\n", "expected whole pixels"),
            ("# Image list with two lines\n1 0.8 0.1 0.2 0.3 1 2 3 1 IMG\n", "is COLMAP's images.txt"),
            ("# 3D point list with one line\n1 0.8 0.1 0.2 255 1 2 3 1 5\n", "is COLMAP's points3D.txt"),
        ],
    )
    def test_what_is_none_is_said(self, read: Written, text: str, message: str) -> None:
        with pytest.raises(PalletLocError) as caught:
            read(text)
        assert message in str(caught.value)


def by_the_manual(kind: str, rays: FloatArray, given: dict[str, float]) -> FloatArray:
    """Return pixels by the formulas of Metashape's manual, the middle of the first pixel at 0."""
    n = {key: given.get(key, 0.0) for key in ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")}
    across = np.hypot(rays[:, 0], rays[:, 1])
    angle = np.arctan2(across, rays[:, 2])
    radius = {"frame": np.tan(angle), "equisolid_fisheye": 2 * np.sin(angle / 2)}.get(kind, angle)
    x, y = (rays[:, i] / across * radius for i in (0, 1))
    r2 = x * x + y * y
    radial = 1 + n["k1"] * r2 + n["k2"] * r2**2 + n["k3"] * r2**3 + n["k4"] * r2**4
    right = x * radial + n["p1"] * (r2 + 2 * x * x) + 2 * n["p2"] * x * y
    down = y * radial + n["p2"] * (r2 + 2 * y * y) + 2 * n["p1"] * x * y
    u = 800 + n["cx"] + right * n["f"] + right * n["b1"] + down * n["b2"]
    return np.stack([u, 600 + n["cy"] + down * n["f"]], axis=-1) - 0.5


class TestMetashape:
    @pytest.mark.parametrize(
        ("kind", "numbers", "within"),
        [
            ("frame", {"f": 1500.0, "cx": 3.1, "cy": -2.2, "k1": -0.1, "k2": 0.03, "k3": -0.004, "p1": 1e-3}, 1e-7),
            ("frame", {"f": 1500.0, "cx": 3.1, "cy": -2.2, "b1": 2.5, "k1": -0.1, "p1": 1e-3, "p2": -5e-4}, 1e-7),
            ("frame", {"f": 1500.0, "b2": 0.6, "k1": -0.1, "k2": 0.05, "k3": -0.01, "k4": 0.003}, 0.5),
            ("frame", {"f": 1500.0}, 1e-7),
            ("fisheye", {"f": 500.0, "cx": 3.1, "cy": -2.2, "b1": 1.0, "k1": 0.05, "k2": -0.01}, 1e-7),
            ("equidistant_fisheye", {"f": 500.0, "k1": 0.05, "k2": -0.01, "k3": 1e-3, "k4": -1e-4}, 1e-7),
            ("equidistant_fisheye", {"f": 500.0, "k1": 0.03, "p1": 2e-4, "p2": -1e-4}, 0.5),
            ("equisolid_fisheye", {"f": 500.0, "cx": 2.0, "k1": 0.01, "k2": -0.002}, 0.5),
        ],
    )
    def test_each_projection_follows_the_manual(
        self, read: Written, kind: str, numbers: dict[str, float], within: float
    ) -> None:
        camera = read(metashape(kind, **numbers))
        rays = rays_of(camera, 77)
        assert np.abs(pixels_of(camera, rays) - by_the_manual(kind, rays, numbers)).max() < within

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (metashape("cylindrical", f=800.0), "calibration.projection: unknown 'cylindrical'"),
            (metashape("frame", k1=0.1), "calibration.f: is missing"),
            (metashape("frame", f=800.0, p3=0.1), "calibration.p3: has no form here"),
            (metashape("equidistant_fisheye", f=500.0, p1=0.05), "this lens has no form here"),
            ("<document version='1.2'><chunks/></document>", "is a project of Metashape"),
            ("<document><chunk/><chunk/></document>", "is a project of Metashape"),
            ("<x:xmpmeta xmlns:x='adobe:ns:meta/'><a/></x:xmpmeta>", "is the XMP of a photo"),
            ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "expected XML without a DOCTYPE"),
            ("<a>" * 30 + "</a>" * 30, "expected XML of at most 20 levels"),
        ],
    )
    def test_what_is_not_read_is_said(self, read: Written, text: str, message: str) -> None:
        with pytest.raises(PalletLocError) as caught:
            read(text)
        assert message in str(caught.value)

    def test_a_spherical_one_is_a_panorama(self, read: Written) -> None:
        assert read(metashape("spherical", f=1.0).replace("1200", "800")) == Equirectangular(1600, 800)


class TestNamedNumbers:
    @pytest.mark.parametrize(
        ("text", "camera"),
        [
            (
                CAMODOCAL.format(kind="KANNALA_BRANDT") + "projection_parameters:\n   k2: 0.01\n   k3: -0.002\n"
                "   k4: 0.0003\n   k5: -0.00001\n   mu: 300.\n   mv: 302.\n   u0: 405.\n   v0: 296.\n",
                KannalaBrandt(800, 600, 300, 302, 405, 296, 0.01, -0.002, 0.0003, -0.00001, 2.0),
            ),
            (
                CAMODOCAL.format(kind="MEI") + MEI,
                Mei(800, 600, 700, 702, 405, 296, 1.7, -0.02, 0.9, 0.001, -0.002),
            ),
            (
                CAMODOCAL.format(kind="PINHOLE")
                + "distortion_parameters: {k1: -0.1, k2: 0.02, p1: 0.001, p2: 0.002}\n"
                "projection_parameters: {fx: 700., fy: 702., cx: 405., cy: 296.}\n",
                Pinhole(800, 600, 700, 702, 405, 296, -0.1, 0.02, 0.001, 0.002),
            ),
            (
                "%YAML:1.0\nFile.version: \"1.0\"\nCamera.type: \"KannalaBrandt8\"\n"
                "Camera1.fx: 300.0\nCamera1.fy: 302.0\n"
                "Camera1.cx: 405.0\nCamera1.cy: 296.0\nCamera1.k1: 0.01\nCamera1.k2: -0.002\nCamera1.k3: 0.0003\n"
                "Camera1.k4: -0.00001\nCamera.width: 800\nCamera.height: 600\nCamera.fps: 20\n",
                KannalaBrandt(800, 600, 300, 302, 405, 296, 0.01, -0.002, 0.0003, -0.00001, 2.0),
            ),
            (
                "%YAML:1.0\nCamera.fx: 700.0\nCamera.fy: 702.0\nCamera.cx: 405.0\nCamera.cy: 296.0\nCamera.k1: -0.1\n"
                "Camera.k2: 0.02\nCamera.p1: 0.001\nCamera.p2: 0.002\nCamera.width: 800\nCamera.height: 600\n",
                Pinhole(800, 600, 700, 702, 405, 296, -0.1, 0.02, 0.001, 0.002),
            ),
            (
                "Camera:\n  name: x\n  setup: monocular\n  model: fisheye\n"
                "  fx: 300.0\n  fy: 302.0\n  cx: 405.0\n  cy: 296.0\n"
                "  k1: 0.01\n  k2: -0.002\n  k3: 0.0003\n  k4: -0.00001\n  cols: 800\n  rows: 600\n",
                KannalaBrandt(800, 600, 300, 302, 405, 296, 0.01, -0.002, 0.0003, -0.00001, 2.0),
            ),
            ("Camera:\n  model: equirectangular\n  cols: 3840\n  rows: 1920\n", Equirectangular(3840, 1920)),
            (
                {"fl_x": 700.0, "fl_y": 702.0, "cx": 405.0, "cy": 296.0, "w": 800, "h": 600, "k1": -0.1, "k2": 0.02,
                 "p1": 0.001, "p2": 0.002, "frames": []},
                Pinhole(800, 600, 700, 702, 404.5, 295.5, -0.1, 0.02, 0.001, 0.002),
            ),
            (
                {"camera_model": "OPENCV_FISHEYE", "fl_x": 300.0, "fl_y": 302.0, "cx": 405.0, "cy": 296.0, "w": 800,
                 "h": 600, "k1": 0.01, "frames": []},
                KannalaBrandt(800, 600, 300, 302, 404.5, 295.5, 0.01, max_angle=2.0),
            ),
            (
                {"is_fisheye": True, "fl_x": 300.0, "fl_y": 302.0, "cx": 405.0, "cy": 296.0, "w": 800, "h": 600},
                KannalaBrandt(800, 600, 300, 302, 404.5, 295.5, max_angle=2.0),
            ),
            (
                {"image": {"width": 800, "height": 600}, "parameter": {"fx": 300, "fy": 302, "cx": 405, "cy": 296,
                                                                       "alpha": 0.6}},
                Eucm(800, 600, 300, 302, 405, 296, 0.6, 1.0),
            ),
            (
                {"image": {"width": 800, "height": 600}, "parameter": {"fx": 700, "fy": 702, "cx": 405, "cy": 296}},
                Pinhole(800, 600, 700, 702, 405, 296),
            ),
        ],
    )  # fmt: skip
    def test_numbers_are_told_by_their_names(self, read: Written, text: object, camera: CameraModel) -> None:
        found = read(text)
        assert type(found) is type(camera)
        points = np.random.default_rng(0).normal(size=(4000, 3))
        ours, theirs = found.project(points), camera.project(points)
        both = ours.valid & theirs.valid
        assert both.sum() > 100
        np.testing.assert_allclose(ours.pixels[both], theirs.pixels[both], atol=1e-9)

    def test_polynomials_of_camodocal_stretch_columns(self, read: Written) -> None:
        camera = read(CAMODOCAL.format(kind="SCARAMUZZA") + SCARAMUZZA)
        assert isinstance(camera, OcamCamera)
        pixels = np.array([[405.0, 296.0], [500.0, 310.0], [300.0, 420.0], [610.0, 150.0], [405.0, 500.0]])
        # column = ac x + ad y + cx, row = ae x + y + cy; the ray of (x, y) is (x, y, -p(r)), right, down, forward.
        x, y = np.linalg.solve([[1.01, 2e-3], [-1e-3, 1.0]], (pixels - [405.0, 296.0]).T)
        r = np.hypot(x, y)
        rays = np.stack([x, y, 220 - 1.5e-3 * r**2 + 1.2e-6 * r**3 - 4e-9 * r**4], axis=-1)
        found = camera.unproject(pixels).directions
        expected = np.stack([rays[:, 2], -rays[:, 0], -rays[:, 1]], axis=-1)
        np.testing.assert_allclose(found, expected / np.linalg.norm(expected, axis=-1, keepdims=True), atol=1e-12)
        angle = np.arctan2(-rays[:, 2], r)
        radius = 330 + 190 * angle - 5 * angle**2 + 10 * angle**3
        unit = np.stack([x, y])[:, 1:] / r[1:] * radius[1:]
        again = np.array([[1.01, 2e-3], [-1e-3, 1.0]]) @ unit + np.array([[405.0], [296.0]])
        np.testing.assert_allclose(camera.project(expected).pixels[1:], again.T, atol=1e-9)
