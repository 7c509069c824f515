"""CameraInfo and OpenCV's storage; the truth is OpenCV's own projection, and REP 104."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.formats.any_format import read_cameras
from palletloc.cameras import KannalaBrandt, Pinhole, RationalPinhole
from palletloc.errors import PalletLocError
from tests.calibration.expecting import Calibrate
from tests.calibration.formats.texts import INFO, MATRIX, Written, echo, pixels_of, rays_of


class TestCameraInfo:
    # REP 104 has these: a camera of 752 x 480, cropped to 640 x 480, binned, with a region of interest.
    @pytest.mark.parametrize(
        ("roi", "binning", "size", "lens"),
        [
            ((0, 0, 0, 0), 0, (752, 480), (400, 402, 380, 236)),
            ((50, 70, 200, 300), 1, (200, 300), (400, 402, 330, 166)),
            ((56, 0, 640, 480), 2, (320, 240), (200, 201, 161.75, 117.75)),
            ((106, 70, 200, 300), 2, (100, 150), (200, 201, 136.75, 82.75)),
            ((0, 0, 752, 480), 3, (250, 160), (400 / 3, 134, 380.5 / 3 - 0.5, 236.5 / 3 - 0.5)),
        ],
    )
    @pytest.mark.parametrize("rectify", [False, True])
    def test_binning_and_region_of_interest_make_the_image(
        self,
        read: Written,
        roi: tuple[int, ...],
        binning: int,
        size: tuple[int, int],
        lens: tuple[float, ...],
        rectify: bool,
    ) -> None:
        given = dict(zip(("x_offset", "y_offset", "width", "height"), roi, strict=True))
        info = {
            **INFO,
            "image_width": 752,
            "camera_matrix": {"data": [400.0, 0, 380, 0, 402, 236, 0, 0, 1]},
            "binning_x": binning,
            "binning_y": binning,
            "roi": {**given, "do_rectify": rectify},
        }
        camera = read(info)
        assert isinstance(camera, Pinhole)
        assert (camera.width, camera.height) == size
        np.testing.assert_allclose([camera.fx, camera.fy, camera.cx, camera.cy], lens, atol=1e-9)
        assert (camera.k1, camera.p2) == (-0.2, -0.002)

    def test_a_binned_pixel_is_the_middle_of_those_that_make_it(self, read: Written) -> None:
        whole, binned = read(INFO), read({**INFO, "binning_x": 4, "binning_y": 2})
        ray = whole.unproject(np.array([(100 + 103) / 2, (60 + 61) / 2])).directions
        np.testing.assert_allclose(binned.project(ray).pixels, [25.0, 30.0], atol=1e-9)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                {"roi": {"x_offset": 400, "y_offset": 0, "width": 320, "height": 200}},
                "roi: expected a part of the 640",
            ),
            ({"roi": {"x_offset": 10, "y_offset": 0, "width": 0, "height": 200}}, "roi: expected a part"),
            ({"binning_x": -2}, "binning_x: expected a whole number"),
            ({"binning_x": 1.5}, "binning_x: expected a whole number"),
            ({"camera_matrix": {"data": [0.0] * 9}}, "camera_matrix.data: is zero: this camera is not calibrated"),
            ({"camera_matrix": {"data": [5, 0, 3, 0, 5, 2, 0, 0, 2]}}, "expected fx, 0, cx, 0, fy, cy, 0, 0, 1"),
            ({"distortion_model": "equidistant"}, "expected 4 numbers for a fisheye, got 5"),
            (
                {"distortion_coefficients": {"data": [0.0] * 6}},
                "data: expected 4 or 5 or 8 or 12 or 14 numbers, got 6",
            ),
            ({"distortion_coefficients": {"data": [1e300] * 5}}, "expected a number up to 1e+12"),
            ({"image_width": 1e9}, "image_width: expected whole pixels"),
        ],
    )
    def test_what_cannot_be_is_one_line(
        self, tmp_path: Path, calibrate: Calibrate, change: dict[str, Any], message: str
    ) -> None:
        (tmp_path / "c.yaml").write_text(json.dumps({**INFO, **change}))
        if "equidistant" in str(change):
            (tmp_path / "c.yaml").write_text(
                json.dumps({**INFO, **change, "distortion_coefficients": {"data": [0.1, 0, 0, 0, 0.2]}})
            )
        calibrate("convert", tmp_path / "c.yaml", "--to", "kalibr", "--out", tmp_path / "o.yaml").refuses(message)

    def test_messages_are_read_as_they_are_printed(self, read: Written) -> None:
        plain = Pinhole(640, 480, 500, 510, 320, 240, -0.2, 0.05)
        assert read(echo()) == plain
        assert read(echo(1) + echo(2) + echo(3)) == plain
        # The last one may be cut off where printing was stopped.
        assert read(echo(1) + echo(2)[:130]) == plain
        assert read(echo(1) + echo(2)[:170]) == plain
        assert read(echo(1).replace("\nK:", "\nk:").replace("\nD:", "\nd:").replace("---\n", "")) == plain
        assert read(echo(kind="", terms=())) == Pinhole(640, 480, 500, 510, 320, 240)
        binned = read(echo(binning=2))
        assert (binned.width, binned.height) == (320, 240)

    def test_messages_of_two_cameras_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "c.yaml").write_text(echo() + echo(terms=(0.1, 0.0, 0.0, 0.0, 0.0)))
        with pytest.raises(PalletLocError, match="is another than the first; expected one camera"):
            read_cameras(tmp_path / "c.yaml")

    @pytest.mark.parametrize("terms", [(0.02, -0.01, 0.003, 0.0), (0.02, -0.01, 0.003, 0.0, 0.0)])
    def test_equidistant_has_four_numbers(self, read: Written, terms: tuple[float, ...]) -> None:
        camera = read(echo(kind="equidistant", terms=terms))
        assert isinstance(camera, KannalaBrandt)
        rays = rays_of(camera)
        theirs, _ = cv2.fisheye.projectPoints(
            rays[:, None], np.zeros(3), np.zeros(3), np.reshape(MATRIX, (3, 3)), np.array(terms[:4])
        )
        np.testing.assert_allclose(pixels_of(camera, rays), np.asarray(theirs)[:, 0], atol=1e-8)

    def test_an_empty_list_is_no_fisheye(self, read: Written) -> None:
        with pytest.raises(PalletLocError, match="D: expected 4 numbers for a fisheye, got 0"):
            read(echo(kind="equidistant", terms=()))

    @pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
    def test_rational_polynomials_image_as_in_opencv(self, read: Written, count: int) -> None:
        terms = np.array(
            [0.35, -0.12, 1e-3, -8e-4, 0.03, 0.61, -0.05, 0.02, 2e-4, 1e-5, -3e-4, 2e-5, 2e-4, -3e-4][:count]
        )
        camera = read(echo(kind="rational_polynomial", terms=terms.tolist()))
        rays = rays_of(camera)
        matrix = np.reshape(MATRIX, (3, 3))
        theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, terms)
        off = np.linalg.norm(pixels_of(camera, rays) - np.asarray(theirs)[:, 0], axis=-1)
        assert off.max() < (1e-8 if count < 12 else 0.5)
        assert count > 8 or isinstance(camera, RationalPinhole if count > 5 else Pinhole)

    def test_what_is_read_only_nearly_says_how_nearly(self, tmp_path: Path, calibrate: Calibrate) -> None:
        terms = [0.1, -0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2e-4, 0.0, 0.0, 0.0]
        (tmp_path / "c").write_text(echo(kind="rational_polynomial", terms=terms))
        ended = calibrate("convert", tmp_path / "c", "--to", "palletloc", "--out", tmp_path / "o.yaml")
        assert ended.code == 0
        note = ended.err.strip()
        assert note.startswith("palletloc: note: camera: has no form of its own here; read as ")
        stated = float(note.split()[-5])
        camera = read_cameras(tmp_path / "o.yaml")[0].camera
        rays = rays_of(camera)
        theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.reshape(MATRIX, (3, 3)), np.array(terms))
        off = np.linalg.norm(pixels_of(camera, rays) - np.asarray(theirs)[:, 0], axis=-1).max()
        assert 0.5 * stated < off < 1.1 * stated
        (tmp_path / "c").write_text(echo(kind="rational_polynomial", terms=[*terms[:8], 0.02, 0.0, 0.0, 0.0]))
        ended = calibrate("convert", tmp_path / "c", "--to", "palletloc", "--out", tmp_path / "p.yaml")
        ended.refuses("this lens has no form here")


class TestOpenCv:
    @pytest.mark.parametrize("suffix", [".xml", ".yml", ".json"])
    @pytest.mark.parametrize("fisheye", [False, True])
    def test_storage_is_read_with_and_without_its_first_line(self, read: Written, suffix: str, fisheye: bool) -> None:
        storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        storage.write("calibration_time", "Tue 01 Dec 2026 01:02:03")
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        storage.write("camera_matrix", np.reshape(MATRIX, (3, 3)))
        terms = [0.01, -0.002, 0.0005, -0.0001] if fisheye else [-0.2, 0.05, 1e-3, -2e-3, 1e-5]
        storage.write("distortion_coefficients", np.array([terms]))
        storage.write("fisheye_model", int(fisheye))
        text = str(storage.releaseAndGetString())
        camera = read(text)
        assert isinstance(camera, KannalaBrandt if fisheye else Pinhole)
        assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.k1) == (500, 510, 320, 240, terms[0])
        if suffix == ".yml":
            assert text.startswith("%YAML")
            assert read(text.partition("\n")[2].removeprefix("---\n")) == camera

    def test_four_numbers_without_a_model_are_said_to_be_taken_for_brown_s(self, tmp_path: Path) -> None:
        info = {key: value for key, value in INFO.items() if key != "distortion_model"}
        path = tmp_path / "c.yaml"
        path.write_text(json.dumps({**info, "distortion_coefficients": {"data": [0.1, 0.0, 0.0, 0.0]}}))
        assert "a fisheye has fisheye_model: 1" in read_cameras(path)[0].note

    def test_skew_is_not_dropped(self, read: Written) -> None:
        matrix = [500.0, 0.4, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
        camera = read({**INFO, "camera_matrix": {"data": matrix}})
        rays = rays_of(camera)
        flat = rays[:, :2] / rays[:, 2:]
        terms = np.array(INFO["distortion_coefficients"]["data"])
        bent, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), terms)
        x, y = np.asarray(bent)[:, 0].T
        theirs = np.stack([500 * x + 0.4 * y + 320, 510 * y + 240], axis=-1)
        assert np.abs(pixels_of(camera, rays) - theirs).max() < 0.5
        with pytest.raises(PalletLocError, match="this lens has no form here"):
            read({**INFO, "camera_matrix": {"data": [500.0, 40.0, *matrix[2:]]}})
        assert len(flat)
