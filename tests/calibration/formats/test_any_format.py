"""Which program wrote a file, files that are not read, and damaged ones."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.formats.any_format import read_cameras
from calibration.formats.kalibr import kalibr_text
from palletloc.cameras import CameraModel, KannalaBrandt, Pinhole
from palletloc.errors import PalletLocError
from tests.calibration.formats.texts import CAMODOCAL, INFO, SCARAMUZZA, Written, chain, echo, metashape

FAULTS = Path(__file__).resolve().parents[3].parent / "shared/data/faults"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ({"taylor_coefficient": [1.0], "distortion_center": [1, 2]}, "is a camera of py-OCamCalib"),
        ({"target_type": "aprilgrid"}, "is a target of Kalibr, no camera"),
        ("%YAML:1.0\ncam0_calib: \"cam0.yaml\"\nimage_width: 5\n", "is settings of VINS-Fusion"),
        ({"frames": [{"fl_x": 5.0}], "camera_angle_x": 1.0}, "is a transforms.json of nerfstudio whose images"),
        ({"v2 unknown 0": {"projection_type": "fisheye"}}, "is a camera of OpenSfM"),
        ("{ 'lensmodel': 'LENSMODEL_OPENCV8', 'intrinsics': [1,2], }", "is a camera of mrcal"),
        ({"camera_model": "FISHEYE624", "fl_x": 1.0, "w": 5, "h": 5}, "camera_model: unknown 'FISHEYE624'"),
        ("model_type: KANALA_BRANDT\n", "model_type: unknown 'KANALA_BRANDT'; did you mean 'KANNALA_BRANDT'"),
        (CAMODOCAL.format(kind="MEI"), "projection_parameters.gamma1: is missing"),
        ("Camera.fx: 5\nCamera.fy: 5\nCamera.cx: 5\nCamera.cy: 5\n", "Camera.width: is missing"),
        ({"some": 1, "other": 2}, "it has some, other"),
        ("a: 1\na: 2\n", "line 2: is not yaml: key 'a' stands there twice"),
        ("a: &a [x, x]\nb: &b [*a, *a]\n" + "".join(
            f"c{i}: &c{i} [{', '.join([f'*c{i - 1}' if i else '*b'] * 9)}]\n" for i in range(9)
        ), "its references stand for more than"),
        ("a: &a [*a]\n", "stands for itself"),
        (echo().replace("500.0, 0.0, 320.0", "8:20, 0.0, 320.0"), "K[0]: expected a finite number, got '8:20'"),
        (echo().replace("width: 640", "width: 0640"), "width: expected a finite number, got '0640'; expected it in"),
        ("1 PINHOLE 640 480 nan 500 320 240\n", "line 1.fx: expected a finite number, got 'nan'"),
        ("1 OPENCV_FISHEYE 640 480 500 500 320 240 1e9 -1e9 0 0\n", "degrees off axis; expected smaller coeff"),
        ("width: 640\nheight: 0x1" + "f" * 20000 + "\nK: []\n", "height: expected a finite number"),
        ("1 PINHOLE 640 480 1e9 500 320 240\n", "line 1: focal lengths and centre: expected pixels from"),
        ("a: !!python/object:os.system x\n", "is not yaml"),
        ('{"a": ' + "1" * 5000 + "}", "a number is too long"),
        ("[" * 100000, "is not JSON"),
        ("", "is no camera file"),
        ("hello\n", "is no camera file"),
    ],
)  # fmt: skip
def test_what_is_not_read_is_named(read: Written, text: object, message: str) -> None:
    with pytest.raises(PalletLocError) as caught:
        read(text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_second_camera_is_not_dropped_without_a_word(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yaml"
    path.write_text(
        "Camera.type: PinHole\nCamera1.fx: 7\nCamera1.fy: 7\nCamera1.cx: 4\nCamera1.cy: 2\nCamera2.fx: 8\n"
        "Camera.width: 8\nCamera.height: 6\n"
    )
    assert "second camera are not read" in read_cameras(path)[0].note


OPENVINS = (460, 460, 730, 720, 0.03, -0.02, 0.003, -5e-4)
PLAIN = Pinhole(640, 480, 500, 500, 320, 240, -0.2, 0.05)
RIGHT: list[tuple[str, int, CameraModel]] = [
    ("colmap-txt/cameras.txt", 0, KannalaBrandt(1920, 1080, 900, 900, 959.5, 539.5, 0.01, -0.001)),
    ("colmap-txt/transforms.json", 0, KannalaBrandt(1920, 1080, 900, 900, 959.5, 539.5, 0.01, -0.001)),
    ("kalibr-many-cameras/k12.yaml", 2, KannalaBrandt(640, 480, 402, 400, 320, 240, 0.02)),
    ("kalibr-with-yaml-line/openvins.yaml", 0, KannalaBrandt(1470, 1440, *OPENVINS)),
    ("metashape-xml/metashape.xml", 0, KannalaBrandt(3040, 3040, 850, 850, 1522.6, 1517.3, 0.05, -0.01)),
    ("opencv-tags-without-header/cv_notag_header.yaml", 0, PLAIN),
    ("ros-binning-roi/ros_binning.yaml", 0, Pinhole(320, 240, 250, 250, 159.75, 119.75, -0.2, 0.05)),
    ("ros-binning-roi/ros_roi.yaml", 0, replace(PLAIN, width=320, height=240, cx=220, cy=180)),
    ("ros-topic-echo/ros2_echo.yaml", 0, KannalaBrandt(640, 480, 300, 300, 320, 240, 0.01, 0.002, -0.001)),
    ("ros-topic-echo/ros_echo.yaml", 0, replace(PLAIN, p1=0.001, p2=-0.001)),
]  # fmt: skip


@pytest.mark.skipif(not FAULTS.is_dir(), reason="the files are not there")
@pytest.mark.parametrize(("name", "number", "camera"), RIGHT, ids=[case[0] for case in RIGHT])
def test_files_that_users_have_are_read_right(name: str, number: int, camera: CameraModel) -> None:
    found = read_cameras(FAULTS / name)[number].camera
    assert type(found) is type(camera)
    names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
    numbers, expected = ([getattr(lens, key, None) for key in names] for lens in (found, camera))
    assert numbers == pytest.approx(expected, abs=1e-9)


SAMPLES = [
    echo(),
    echo() + echo(2),
    json.dumps(INFO),
    metashape("equidistant_fisheye", f=500.0, k1=0.05),
    CAMODOCAL.format(kind="SCARAMUZZA") + SCARAMUZZA,
    "1 OPENCV_FISHEYE 1920 1080 900 900 960 540 0.01 -0.001 0 0\n",
    kalibr_text(chain(2)),
]


@settings(max_examples=2 * settings().max_examples)
@given(st.sampled_from(SAMPLES), st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=3)), min_size=1, max_size=4))
def test_damaged_files_are_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, sample: str, damage: list[tuple[float, bytes]]
) -> None:
    content = sample.encode()
    for share, part in damage:
        at = int(share * len(content))
        content = content[:at] + part + content[at + len(part) :]
    path = tmp_path_factory.mktemp("damaged", numbered=True) / "camera"
    path.write_bytes(content)
    said = ""
    try:
        read_cameras(path)
    except PalletLocError as error:
        said = str(error)
    assert not said or (str(path) in said and "\n" not in said)
