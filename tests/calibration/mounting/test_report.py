import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration import calibrate_mounting
from calibration.mounting.report import mounting_page
from calibration.result_page import write_result
from palletloc.geometry import Image
from palletloc.io.camera_spec import transform_from_angles
from palletloc.io.recording import read_recording
from tests.calibration.expecting import Calibrate
from tests.calibration.yard_folder import CAMERA, CORNERS, Change, board_key, copied, render_yard, set_key, write

DEV_YARD = Path(__file__).resolve().parents[3].parent / "shared/data/dev_yard"


@pytest.fixture(scope="module")
def folder(
    tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image], forklift_from_camera: RigidTransform
) -> Path:
    """Return a folder with a shot of four surveyed boards."""
    folder = tmp_path_factory.mktemp("yard")
    rng, targets = np.random.default_rng(0), {}
    for k, points in enumerate(render_yard(folder, render, forklift_from_camera)):
        surveyed = (points + rng.normal(0, 0.0005, (3, 3))).round(5).tolist()
        corners = dict(zip(CORNERS, surveyed, strict=True))
        targets[f"B{k}"] = board_key(k) | {"corners_m": corners, "sigma_m": 0.0005}
    write(folder, {"targets": targets})
    return folder


def variant(folder: Path, place: Path, change: Change) -> Path:
    """Return a copy of the folder with another extrinsics.yaml."""
    content = copied(folder, place)
    change(content)
    write(place, content)
    return place


def test_a_yard_gives_a_rig_that_a_recording_takes(
    folder: Path, tmp_path: Path, forklift_from_camera: RigidTransform, calibrate: Calibrate
) -> None:
    rig = tmp_path / "rig.yaml"
    ended = calibrate("extrinsics", folder, "--out", rig)
    assert ended.code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.html", "rig.json", "rig.yaml"]
    assert "forklift_from_camera" in ended.out
    recording = tmp_path / "recording"
    recording.mkdir()
    shelf = "shelf: {point_m: [3.0, 1.8], facing_deg: -90.0}\npallets: [epal1-1200]\n"
    (recording / "recording.yaml").write_text(rig.read_text() + shelf)
    (recording / "shots.csv").write_text("time_s,file\n0.0,shot.png\n")
    (recording / "odometry.csv").write_text("time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps\n0,0,0,0,0,0\n")
    mounting = read_recording(recording).mounting
    off = forklift_from_camera * mounting.forklift_from_camera.inv()
    moved = np.abs(mounting.center - forklift_from_camera.translation)
    assert (moved < 4 * np.array(mounting.translation_sigma)).all()
    assert moved.max() < 0.002
    assert (np.abs(off.rotation.as_rotvec()) < 4 * np.array(mounting.rotation_sigma)).all()
    assert read_recording(recording).camera == CAMERA


def test_the_report_needs_nothing_but_itself(folder: Path, tmp_path: Path) -> None:
    result = calibrate_mounting(folder)
    assert result.mounting is not None
    write_result(mounting_page(result), tmp_path / "rig.yaml")
    page, data = (tmp_path / "rig.html").read_text(), json.loads((tmp_path / "rig.json").read_text())
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 4
    assert "http" not in page
    assert [part["target"] for part in data["residuals"]] == ["B0", "B1", "B2", "B3"]
    assert max(part["rms_px"] for part in data["residuals"]) < 0.05
    assert np.array(data["forklift_from_camera"]["covariance"]).shape == (6, 6)
    assert {left["target"] for left in data["left_out"]} == {"B0", "B1", "B2", "B3"}


def test_a_single_board_is_degenerate(folder: Path, tmp_path: Path, calibrate: Calibrate) -> None:
    single = variant(
        folder, tmp_path / "single", lambda content: [content["targets"].pop(k) for k in ("B0", "B2", "B3")]
    )
    ended = calibrate("extrinsics", single, "--out", tmp_path / "rig.yaml")
    assert ended.code == 3
    assert "degenerate: one_target:" in ended.err
    assert not (tmp_path / "rig.yaml").exists()
    reasons = json.loads((tmp_path / "rig.failed.json").read_text())["reasons"]
    assert [(reason["code"], bool(reason["what"]), bool(reason["how"])) for reason in reasons] == [
        ("one_target", True, True)
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_key("targets", "B1", "charuco", "dictionary", value="DICT_4X4_51"), "targets.B1: unknown dictionary"),
        (
            set_key("targets", "B1", "charuco", "first_id", value=4),
            "has the marker 4 of DICT_4X4_50, which B0 has too",
        ),
        (set_key("targets", "B1", "charuco", "first_id", value=48), "the ids 0 to 49; the target needs 48 to 53"),
        (set_key("targets", "B1", "charuco", "marker_m", value=0.2), "smaller than its square"),
        (set_key("targets", "B1", "sigma_m", value=0), "targets.B1.sigma_m: expected a finite positive number"),
        (set_key("targets", "B1", "corners_m", "top_left", value=[1, 2]), "corners_m.top_left: expected 3 finite"),
        (
            set_key("targets", "B1", "tag", value={"dictionary": "DICT_4X4_50", "id": 1, "size_m": 0.1}),
            "one of the keys",
        ),
        (set_key("targets", "B1", "charuko", value={}), "unknown key 'charuko'; did you mean 'charuco'?"),
        (set_key("targets", value={}), "targets: "),
        (set_key("shots", value=["other.png"]), "other.png: no such file"),
        (set_key("camera", "width", value=1000), "the camera is 1000 x 640"),
    ],
)
def test_bad_input_is_one_line(
    folder: Path, tmp_path: Path, calibrate: Calibrate, change: Change, message: str
) -> None:
    wrong = variant(folder, tmp_path / "bad", change)
    calibrate("extrinsics", wrong, "--out", tmp_path / "rig.yaml").refuses(message)
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]


@pytest.mark.slow
@pytest.mark.skipif(not DEV_YARD.is_dir(), reason="the yard is not there")
def test_the_photographed_yard_is_within_its_own_sigmas(tmp_path: Path) -> None:
    result = calibrate_mounting(DEV_YARD)
    assert result.findings == ()
    write_result(mounting_page(result), tmp_path / "rig.yaml")
    data = json.loads((tmp_path / "rig.json").read_text())
    found = data["forklift_from_camera"]
    truth = json.loads((DEV_YARD / "truth.json").read_text())["forklift_from_camera"]
    moved = np.abs(np.subtract(found["translation_m"], truth["translation_m"]))
    mounting, true = (transform_from_angles(f["translation_m"], f["roll_pitch_yaw_deg"]) for f in (found, truth))
    turned = np.degrees(np.abs((mounting.rotation * true.rotation.inv()).as_rotvec()))
    assert (moved < np.minimum(0.002, 3 * np.array(found["translation_sigma_m"]))).all()
    assert (turned < np.minimum(0.03, 3 * np.array(found["rotation_sigma_deg"]))).all()
    assert np.abs([left["shift_in_sigma"] for left in data["left_out"]]).max() < 2
