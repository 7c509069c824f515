import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.formats.camera_file import FiledCamera, camera_text, optical
from calibration.formats.convert import convert_camera, read_cameras
from calibration.formats.fields import FormatError
from calibration.formats.kalibr import kalibr_text
from calibration.formats.ocam import OcamCamera
from calibration.targets.board_detection import detect_markers
from palletloc.cameras import (
    CameraModel,
    DoubleSphere,
    DualFisheye,
    Equirectangular,
    Eucm,
    FisheyeLens,
    KannalaBrandt,
    Mei,
    Pinhole,
    RationalPinhole,
)
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import spec_from_camera
from tests.calibration.expecting import Calibrate, present

SHARED = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses"
CAMERAS: dict[str, CameraModel] = {
    "kannala_brandt": KannalaBrandt(900, 800, 210.0, 213.0, 451.0, 397.0, 0.03, -0.012, 0.002, -0.0002, 1.6),
    "mei": Mei(1280, 960, 409.0, 410.5, 630.3, 431.9, 1.053, -0.0083, 0.0118, 0.0028, -0.0042, 1.5),
    "double_sphere": DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566, 1.6),
    "eucm": Eucm(752, 480, 210.0, 211.0, 365.8, 248.9, 0.586, 1.139, 1.6),
    "pinhole": Pinhole(800, 600, 520.0, 525.0, 405.0, 296.0, -0.28, 0.09, 0.002, -0.0015),
    "rational_pinhole": RationalPinhole(
        *(800, 600, 520.0, 525.0, 405.0, 296.0), *(0.35, -0.12, 0.0012, -0.0008, 0.03, 0.61, -0.05, 0.02)
    ),
}
HOLDS = {
    "palletloc": tuple(CAMERAS),
    "kalibr": ("kannala_brandt", "mei", "double_sphere", "eucm", "pinhole"),
    "basalt": ("kannala_brandt", "double_sphere", "eucm", "pinhole", "rational_pinhole"),
    "ros": ("kannala_brandt", "pinhole", "rational_pinhole"),
    "opencv": ("kannala_brandt", "mei", "pinhole", "rational_pinhole"),
}
PLAIN = ", distortion_model: none, distortion_coeffs: []"
SUFFIX = {"palletloc": ".yaml", "kalibr": ".yaml", "basalt": ".json", "ros": ".yaml", "opencv": ".xml"}


def source(folder: Path, camera: CameraModel) -> Path:
    path = folder / "source.yaml"
    path.write_text(camera_text(camera))
    return path


def rays(camera: CameraModel) -> FloatArray:
    u, v = np.meshgrid(np.arange(5.0, camera.width - 5, 23), np.arange(5.0, camera.height - 5, 19))
    found = camera.unproject(np.stack([u, v], axis=-1))
    return np.asarray(found.directions[found.valid])


def test_every_format_and_model_keeps_the_camera(tmp_path: Path) -> None:
    for form, names in HOLDS.items():
        for name in names:
            camera = CAMERAS[name]
            out = tmp_path / f"{form}-{name}{SUFFIX[form]}"
            done = convert_camera(source(tmp_path, camera), form, out)
            assert (done.source, done.target) == (name, name)
            assert done.differences[0].largest < 1e-8, (form, name)
            assert done.differences[0].unseen == 0.0
            again = read_cameras(out)[0].camera
            np.testing.assert_allclose(
                again.project(rays(camera)).pixels, camera.project(rays(camera)).pixels, atol=1e-8
            )


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".json"])
def test_opencv_reads_what_is_written_for_it(tmp_path: Path, suffix: str) -> None:
    camera = CAMERAS["pinhole"]
    assert isinstance(camera, Pinhole)
    convert_camera(source(tmp_path, camera), "opencv", tmp_path / f"out{suffix}")
    storage = cv2.FileStorage(str(tmp_path / f"out{suffix}"), cv2.FILE_STORAGE_READ)
    matrix, terms = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    points = rays(camera)
    theirs, _ = cv2.projectPoints(
        np.stack([-points[:, 1], -points[:, 2], points[:, 0]], axis=-1), np.zeros(3), np.zeros(3), matrix, terms
    )
    np.testing.assert_allclose(camera.project(points).pixels, np.asarray(theirs)[:, 0], atol=1e-8)


@pytest.mark.parametrize("model", ["kannala_brandt", "double_sphere", "eucm"])
@pytest.mark.parametrize("name", ["kannala_brandt", "double_sphere", "eucm", "mei"])
def test_fisheye_models_stand_for_each_other_within_a_few_pixels(tmp_path: Path, name: str, model: str) -> None:
    done = convert_camera(source(tmp_path, CAMERAS[name]), f"palletloc/{model}", tmp_path / "out.yaml", max_angle=1.4)
    camera = read_cameras(tmp_path / "out.yaml")[0].camera
    assert spec_from_camera(camera).model == model == done.target
    # What is stated is what is there.
    there = rays(CAMERAS[name])
    there = there[there[:, 0] > np.cos(1.4)]
    off = np.linalg.norm(camera.project(there).pixels - CAMERAS[name].project(there).pixels, axis=-1)
    assert np.sqrt(np.nanmean(off**2)) == pytest.approx(done.differences[0].rms, rel=0.3, abs=0.01)
    assert done.differences[0].rms < (0.05 if name == model else 5.0)


def test_ocam_follows_a_fisheye_beyond_90_degrees(tmp_path: Path) -> None:
    camera = KannalaBrandt(1000, 1000, 260.0, 261.0, 498.0, 502.0, 0.02, -0.008, 0.001, 0.0, np.radians(100.0))
    done = convert_camera(source(tmp_path, camera), "ocam", tmp_path / "out.txt")
    assert done.differences[0].largest < 0.1
    ocam = read_cameras(tmp_path / "out.txt")[0].camera
    assert isinstance(ocam, OcamCamera)
    there = rays(camera)
    there = there[there[:, 0] > np.cos(np.radians(99.0))]
    pixels = ocam.project(there).pixels
    np.testing.assert_allclose(pixels, camera.project(there).pixels, atol=0.1)
    seen = np.isfinite(pixels).all(-1)
    np.testing.assert_allclose(ocam.unproject(pixels[seen]).directions, there[seen], atol=1e-3)


def test_two_lenses_go_to_kalibr_and_basalt_and_come_back(tmp_path: Path) -> None:
    lens = KannalaBrandt(1000, 500, 140.0, 141.0, 249.0, 250.0, 0.01, -0.002, 0.0, 0.0, 1.7)
    back = KannalaBrandt(1000, 500, 142.0, 141.0, 748.0, 251.0, 0.01, -0.002, 0.0, 0.0, 1.7)
    places = [
        RigidTransform.from_components([0.01, 0, 0], Rotation.from_euler("zyx", [0.02, -0.01, 0.005])),
        RigidTransform.from_components([-0.012, 0.001, 0], Rotation.from_euler("zyx", [3.1, 0.02, 0.01])),
    ]
    dual = DualFisheye(FisheyeLens(lens, places[0]), FisheyeLens(back, places[1]))
    for form in ("kalibr", "basalt"):
        convert_camera(source(tmp_path, dual), form, tmp_path / f"out{SUFFIX[form]}")
        first, second = read_cameras(tmp_path / f"out{SUFFIX[form]}")
        between = places[0].inv() * places[1]
        np.testing.assert_allclose(second.first_from_camera.as_matrix(), between.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(first.first_from_camera.as_matrix(), np.eye(4), atol=1e-12)


def test_a_camchain_of_two_becomes_one_image_side_by_side(tmp_path: Path) -> None:
    lens = KannalaBrandt(500, 500, 140.0, 141.0, 249.0, 250.0, 0.01, -0.002, 0.0, 0.0, 1.6)
    place = RigidTransform.from_components([-0.04, 0.0, 0.001], Rotation.from_euler("z", 3.13))
    chain = tmp_path / "chain.yaml"
    chain.write_text(
        kalibr_text([FiledCamera("cam0", lens, RigidTransform.identity()), FiledCamera("cam1", lens, place)])
    )
    # Kalibr: a point of cam0's optical frame in cam1's.
    written = np.array(yaml.safe_load(chain.read_text())["cam1"]["T_cn_cnm1"])
    np.testing.assert_allclose(written, optical(place.inv()), atol=1e-12)
    convert_camera(chain, "palletloc/dual_fisheye", tmp_path / "dual.yaml")
    content = yaml.safe_load((tmp_path / "dual.yaml").read_text())["camera"]
    assert (content["model"], content["width"]) == ("dual_fisheye", 1000)
    assert content["lenses"][1]["center_px"] == [749.0, 250.0]
    apart = np.subtract(content["lenses"][1]["translation_m"], content["lenses"][0]["translation_m"])
    np.testing.assert_allclose(apart, [-0.04, 0.0, 0.001], atol=1e-9)


@pytest.mark.parametrize(
    ("names", "camera"),
    [
        (
            "omni, intrinsics: [1.1,400,401,320,240], distortion_model: radtan, distortion_coeffs: [.1,.2,.01,.02]",
            Mei(640, 480, 400, 401, 320, 240, 1.1, 0.1, 0.2, 0.01, 0.02),
        ),
        (
            "ds, intrinsics: [-0.2, 0.6, 400, 401, 320, 240]" + PLAIN,
            DoubleSphere(640, 480, 400, 401, 320, 240, -0.2, 0.6),
        ),
        ("eucm, intrinsics: [0.6, 1.1, 400, 401, 320, 240]" + PLAIN, Eucm(640, 480, 400, 401, 320, 240, 0.6, 1.1)),
    ],
)
def test_names_of_kalibr_keep_their_order_of_numbers(tmp_path: Path, names: str, camera: CameraModel) -> None:
    path = tmp_path / "chain.yaml"
    path.write_text(f"cam0: {{camera_model: {names}, resolution: [640, 480]}}\n")
    assert read_cameras(path)[0].camera == camera


KALIBR = {
    "cam0": {
        "camera_model": "pinhole",
        "intrinsics": [400.0, 401.0, 320.0, 240.0],
        "distortion_model": "equidistant",
        "distortion_coeffs": [0.1, 0.0, 0.0, 0.0],
        "resolution": [640, 480],
    }
}
BASALT = {
    "value0": {
        "T_imu_cam": [{"px": 0.0, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}],
        "intrinsics": [
            {"camera_type": "ds", "intrinsics": {"fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0, "xi": 0.0, "alpha": 0.5}}
        ],
        "resolution": [[640, 480]],
    }
}
ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "front",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [400.0, 0, 320.0, 0, 401.0, 240.0, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0, 0.0, 0.0, 0.0, 0.0]},
}


def changed(content: dict[str, Any], place: str, value: object) -> dict[str, Any]:
    copy: dict[str, Any] = json.loads(json.dumps(content))
    *path, last = place.split(".")
    inner: Any = copy
    for step in path:
        inner = inner[int(step) if isinstance(inner, list) else step]
    if value is None:
        del inner[last]
    else:
        inner[int(last) if isinstance(inner, list) else last] = value
    return copy


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.yaml", changed(KALIBR, "cam0.intrinsics", [1.0, 2.0]), "cam0.intrinsics: expected 4 numbers, got [1"),
        ("a.yaml", changed(KALIBR, "cam0.intrinsics.0", -400.0), "cam0: focal lengths must be positive"),
        ("a.yaml", changed(KALIBR, "cam0.camera_model", "pinhol"), "unknown 'pinhol'; did you mean 'pinhole'"),
        ("a.yaml", changed(KALIBR, "cam0.distortion_model", "fov"), "cam0.distortion_model: unknown 'fov'"),
        ("a.yaml", changed(KALIBR, "cam0.resolution", None), "cam0.resolution: is missing"),
        ("a.yaml", changed(KALIBR, "cam0.resolution", [640, 0]), "cam0.resolution: expected whole pixels"),
        ("a.yaml", {**KALIBR, "cam1": KALIBR["cam0"]}, "cam1.T_cn_cnm1: is missing"),
        (
            "a.yaml",
            {**KALIBR, "cam1": {**KALIBR["cam0"], "T_cn_cnm1": np.diag([1, 2, 1, 1]).tolist()}},
            "cam1.T_cn_cnm1: expected a rotation",
        ),
        ("a.json", changed(BASALT, "value0.resolution", []), "value0.resolution: expected as many entries"),
        ("a.json", changed(BASALT, "value0.intrinsics.0.camera_type", "xyz"), "camera_type: unknown 'xyz'"),
        ("a.json", changed(BASALT, "value0.intrinsics.0.intrinsics.xi", None), "intrinsics.xi: is missing"),
        ("a.json", changed(BASALT, "value0.T_imu_cam.0.qw", 2.0), "T_imu_cam[0]: expected a quaternion of length 1"),
        ("a.yaml", changed(ROS, "distortion_model", "plum_bob"), "unknown 'plum_bob'; did you mean 'plumb_bob'"),
        ("a.yaml", changed(ROS, "camera_matrix.data", [1.0]), "camera_matrix.data: expected 9 numbers"),
        ("a.yaml", changed(ROS, "distortion_coefficients.data.1", "x"), "data[1]: expected a finite number, got 'x'"),
        ("a.yaml", {"nothing": 1}, "is no camera file; expected the keys camera"),
        ("a.yaml", {"camera": {"model": "eucm", "width": 5}}, "camera.height: is missing"),
        ("a.yaml", [1, 2], "is no camera file"),
        ("a.yaml", "cam0: [", "line 1: is not yaml"),
        ("a.json", '{"value0": ', "line 1: is not JSON"),
        ("a.xml", "<?xml version='1.0'?><opencv_storage><broken>", "is not a file of OpenCV"),
        ("a.xml", "<?xml version='1.0'?>\n<opencv_storage>\n</opencv_storage>\n", "image_width: is missing"),
        ("a.txt", "5 -1 0\n", "expected 5 lines of numbers"),
        ("a.txt", "2 -1 0\n2 5 x\n1 1\n1 0 0\n9 9\n", "line 2: expected finite numbers"),
        ("a.txt", "2 -1 0\n3 5 1\n1 1\n1 0 0\n9 9\n", "line 2: expected a count and as many coefficients"),
        ("a.txt", "2 -1 0\n2 5 1\n1 1\n1 0 0\n9.5 9\n", "line 5: expected height and width"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_line_with_its_place(
    tmp_path: Path, calibrate: Calibrate, name: str, content: object, message: str
) -> None:
    path, out = tmp_path / name, tmp_path / "o.yaml"
    text = content if isinstance(content, str) else None
    path.write_text(text or (json.dumps(content) if name.endswith("json") else yaml.safe_dump(content)))
    ended = calibrate("convert", path, "--to", "palletloc", "--out", out)
    ended.refuses(message)
    assert str(path) in ended.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--to", "kalib", "--out", "o.yaml"), "unknown format 'kalib'; did you mean 'kalibr'"),
        (("--to", "ros/mei", "--out", "o.yaml"), "ros has no model 'mei'"),
        (("--to", "basalt", "--out", "o.yaml"), "expected a name that ends in .json"),
        (("--to", "kalibr", "--out", "o.yaml", "--camera", "1"), "has the cameras 0 to 0"),
        (("--to", "palletloc/dual_fisheye", "--out", "o.yaml"), "expected two kannala_brandt cameras"),
    ],
)
def test_a_wrong_request_is_one_line(
    tmp_path: Path, calibrate: Calibrate, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = source(tmp_path, CAMERAS["eucm"])
    calibrate("convert", path, *arguments).refuses(message)


def test_a_panorama_has_no_lens(tmp_path: Path, calibrate: Calibrate) -> None:
    path = source(tmp_path, Equirectangular(200, 100))
    arguments = "convert", path, "--out", tmp_path / "o.yaml", "--to"
    calibrate(*arguments, "kalibr").refuses("a stitched panorama has no form in kalibr")
    assert calibrate(*arguments, "palletloc").code == 0


@pytest.mark.skipif(not SHARED.is_dir(), reason="the lenses are not there")
def test_a_real_ocam_calibration_shows_tags_far_off_axis(tmp_path: Path) -> None:
    done = convert_camera(SHARED / "wide/calib_results.txt", "palletloc", tmp_path / "wide.yaml")
    assert done.differences[0].rms < 0.5
    ocam = read_cameras(SHARED / "wide/calib_results.txt")[0].camera
    # Its two polynomials are each other's inverse.
    there = rays(ocam)
    again = ocam.unproject(ocam.project(there).pixels)
    assert np.degrees(np.linalg.norm(again.directions - there, axis=-1)[again.valid]).max() < 0.1
    image = present(cv2.imread(str(SHARED / "wide/image.jpg"), cv2.IMREAD_GRAYSCALE))
    fisheye = read_cameras(tmp_path / "wide.yaml")[0].camera
    markers = detect_markers(fisheye, np.asarray(image, dtype=np.uint8), "DICT_APRILTAG_36h11", 1.5)
    assert {marker.id for marker in markers} >= {1, 2}


ADAPTER = {
    "double_sphere": (
        {"xi": -0.24, "alpha": 0.566},
        DoubleSphere(752, 480, 210.0, 211.0, 365.8, 249.4, -0.24, 0.566),
    ),
    "eucm": ({"alpha": 0.586, "beta": 1.139}, Eucm(752, 480, 210.0, 211.0, 365.8, 249.4, 0.586, 1.139)),
    "pinhole": (
        {"k1": -0.28, "k2": 0.09, "p1": 0.002, "p2": -0.0015, "k3": 0.0},
        Pinhole(752, 480, 210.0, 211.0, 365.8, 249.4, -0.28, 0.09, 0.002, -0.0015),
    ),
}


def adapter_file(path: Path, terms: dict[str, float]) -> Path:
    lens = {"fx": 210.0, "fy": 211.0, "cx": 365.8, "cy": 249.4}
    path.write_text(yaml.safe_dump({"image": {"width": 752, "height": 480}, "parameter": {**lens, **terms}}))
    return path


@pytest.mark.parametrize("model", sorted(ADAPTER))
def test_files_of_the_adapter_are_told_apart_by_their_numbers(model: str, tmp_path: Path) -> None:
    terms, expected = ADAPTER[model]
    found = read_cameras(adapter_file(tmp_path / "lens.yml", terms))[0].camera
    assert type(found) is type(expected)
    points = np.random.default_rng(0).normal(size=(500, 3))
    np.testing.assert_array_equal(found.project(points).pixels, expected.project(points).pixels)


def test_unknown_numbers_of_an_adapter_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="parameter: expected fx, fy, cx, cy and one of"):
        read_cameras(adapter_file(tmp_path / "lens.yml", {"xi": 1.0}))


@pytest.mark.skipif(not SHARED.is_dir(), reason="the lenses are not there")
def test_four_models_of_one_real_lens_see_the_same() -> None:
    cameras = [read_cameras(path)[0].camera for path in sorted((SHARED / "one_lens").glob("*.yml"))]
    assert len(cameras) == 4
    u, v = np.meshgrid(np.linspace(60, 690, 12), np.linspace(50, 430, 9))
    seen = [camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1)) for camera in cameras]
    for other in seen[1:]:
        apart = np.degrees(np.linalg.norm(other.directions - seen[0].directions, axis=1))
        assert np.sqrt((apart**2).mean()) < 0.15
