import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.mounting.consensus import agree
from calibration.mounting.fit import fit_mounting
from calibration.mounting.problem import SurveyedTarget
from calibration.plan.assessment import assess_plan
from calibration.plan.prediction import Layout, PlannedTarget, predict
from calibration.targets.targets import CharucoBoard, facing, on_board, patterns
from palletloc.cameras import Equirectangular, Pinhole
from tests.calibration.expecting import Calibrate, present
from tests.calibration.simulated_yard import Yard, YardErrors, boards_around, pose_error, simulate_yard
from tests.calibration.yard_folder import Change, set_key

CAMERA = Equirectangular(3840, 1920)
BOARD = CharucoBoard(4, 3, 0.12, 0.09, "DICT_4X4_250")
EYE = RigidTransform.from_components([0.3, 0.1, 1.9], Rotation.identity())
FRONT, BACK, LEFT, RIGHT = [3.0, 0.0, 1.6], [-2.6, 0.3, 1.2], [0.2, 2.5, 1.9], [0.5, -2.4, 0.8]


def layout_of(boards: list[RigidTransform], errors: YardErrors, camera_pose: RigidTransform = EYE) -> Layout:
    pattern = patterns(BOARD)[0]
    outline = on_board(pattern.outline)
    planned = [
        PlannedTarget(pattern, SurveyedTarget(f"B{k}", outline, pose.apply(outline), errors.survey))
        for k, pose in enumerate(boards)
    ]
    return Layout(CAMERA, camera_pose, tuple(planned), 0.1, errors.bearing)


@pytest.mark.parametrize("azimuths", [(0.4, 2.0, -2.6, -1.2), (0.3, 1.4), (0.2, 0.8, -0.5)])
def test_what_is_predicted_is_what_the_fit_states(
    yard: Callable[..., Yard], azimuths: tuple[float, ...], forklift_from_camera: RigidTransform
) -> None:
    errors = YardErrors(survey=0.001, bearing=1e-4, drawn=False)
    drawn = yard(azimuths, 3, errors, BOARD)
    jacobian = drawn.problem.jacobian(drawn.truth)
    expected = np.linalg.inv(jacobian.T @ jacobian)[:6, :6]
    boards = boards_around(forklift_from_camera.translation, azimuths, 3)
    actual = predict(layout_of(boards, errors, forklift_from_camera)).covariance
    np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-6 * expected.max())


@pytest.mark.slow
def test_simulated_calibrations_scatter_as_predicted(forklift_from_camera: RigidTransform) -> None:
    azimuths, errors = (0.4, 2.0, -2.6, -1.2), YardErrors(survey=0.001, bearing=2e-4)
    boards = boards_around(forklift_from_camera.translation, azimuths, 0)
    predicted = predict(layout_of(boards, errors, forklift_from_camera)).sigma
    off = []
    for seed in range(400):
        drawn = simulate_yard(patterns(BOARD)[0], forklift_from_camera, boards, errors, seed)
        start = present(agree(drawn.problem))
        camera = fit_mounting(start.problem, start.poses).poses.camera
        off.append(pose_error(camera, forklift_from_camera))
    scatter = np.sqrt(np.mean(np.square(off), axis=0))
    # The root mean square of n numbers is known to 1 / sqrt(2 n); six are compared.
    np.testing.assert_allclose(scatter / predicted, 1.0, atol=3.5 / np.sqrt(2 * 400))


TAG_SPEC = {"dictionary": "DICT_APRILTAG_36h11", "size_m": 0.2}


def write(place: Path, centers: list[list[float]], change: Change = lambda _: None, **more: object) -> Path:
    """Write a layout of tags, each with more keys."""
    targets = {
        f"T{k}": {"tag": TAG_SPEC | {"id": k}, "center_m": center, "sigma_m": 0.001} | more
        for k, center in enumerate(centers)
    }
    content: dict[str, Any] = {
        "format": 1,
        "camera": {"model": "equirectangular", "width": 3840, "height": 1920},
        "forklift_from_camera": {"translation_m": [0.3, 0.1, 1.9], "roll_pitch_yaw_deg": [0, 0, 0]},
        "corner_deg": 0.02,
        "targets": targets,
    }
    change(content)
    path = place / "layout.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_tags_on_four_sides_pass(tmp_path: Path, calibrate: Calibrate) -> None:
    corners = [[x, y, z] for x, y, z in ([2.8, 2.1, 1.0], [-2.2, 2.3, 1.7], [-2.3, -2.1, 1.1], [2.9, -2.0, 2.2])]
    path = write(tmp_path, [FRONT, BACK, LEFT, RIGHT, *corners])
    ended = calibrate("plan", path, "--out", tmp_path / "plan.html")
    assert (ended.code, ended.err) == (0, "")
    assert "predicted sigma" in ended.out
    page, data = (tmp_path / "plan.html").read_text(), json.loads((tmp_path / "plan.json").read_text())
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 1
    # Published for eight tags on four walls at 0.02 degrees and 1 mm: 0.6, 0.6, 0.4 mm and 0.01 degrees.
    assert max(data["predicted"]["translation_sigma_m"]) < 0.001
    assert max(data["predicted"]["rotation_sigma_deg"]) < 0.02
    assert data["lost_directions"] == []
    assert 0 < data["survey_share"] < 1
    assert len(data["targets"]) == 8


def test_one_wall_has_the_published_sigmas_and_is_refused(tmp_path: Path, calibrate: Calibrate) -> None:
    centers = [[3.3, y, z] for y in (-1.0, 1.0) for z in (1.4, 2.4)]
    ended = calibrate("plan", write(tmp_path, centers, facing_deg=180.0), "--out", tmp_path / "plan.html")
    assert ended.code == 3
    assert "degenerate: one_wall:" in ended.err
    assert "hang a target like" in ended.err
    data = json.loads((tmp_path / "plan.failed.json").read_text())
    sigma = np.array(data["predicted"]["translation_sigma_m"])
    # Published for four tags on a wall at 0.02 degrees and 1 mm: along the line of sight 1.6 mm, across it 6.7 mm.
    assert sigma == pytest.approx([0.0016, 0.0067, 0.0067], rel=0.4)
    assert max(data["predicted"]["rotation_sigma_deg"]) == pytest.approx(0.13, rel=0.3)
    assert max(data["suggestion"]["translation_sigma_m"]) < 0.5 * sigma.max()
    assert not (tmp_path / "plan.html").exists()


@pytest.mark.parametrize(
    ("centers", "code"),
    [
        ([FRONT], "one_target"),
        ([[2.0, y, 1.5] for y in (-2.5, 0.0, 2.5)], "collinear"),
        ([[2.5, 0.0, 1.5], [2.6, 0.3, 1.7], [2.7, -0.2, 1.4]], "narrow_cone"),
    ],
)
def test_degenerate_layouts_are_named(
    tmp_path: Path, calibrate: Calibrate, centers: list[list[float]], code: str
) -> None:
    ended = calibrate("plan", write(tmp_path, centers, facing_deg=180.0))
    assert ended.code == 3
    assert f"degenerate: {code}:" in ended.err


def test_one_more_target_helps_as_much_as_promised() -> None:
    boards = boards_around(EYE.translation, (0.3, -0.4, 0.1), 1)
    layout = layout_of(boards, YardErrors(survey=0.001, bearing=2e-4))
    before = assess_plan(layout)
    offer = present(before.suggestion)
    level = np.sqrt(2.0**2 - offer.above**2)
    middle = EYE.translation + np.array([level * np.cos(offer.azimuth), level * np.sin(offer.azimuth), offer.above])
    model = layout.targets[0]
    shape = model.survey.outline
    pose = facing(middle, EYE.translation)
    points = pose.apply(shape) - pose.rotation.apply((shape[1] + shape[2]) / 2)
    more = PlannedTarget(model.pattern, SurveyedTarget("N", shape, points, 0.001))
    after = predict(Layout(CAMERA, EYE, (*layout.targets, more), 0.1, 2e-4)).sigma
    np.testing.assert_allclose(after, offer.sigma, rtol=1e-6)
    assert (after < before.prediction.sigma).all()


def test_a_target_that_is_not_seen_gives_nothing() -> None:
    camera = Pinhole(1920, 1080, 900.0, 900.0, 960.0, 540.0)
    boards = boards_around(EYE.translation, (0.2, -0.3, 3.0), 2)
    layout = layout_of(boards, YardErrors())
    told = assess_plan(Layout(camera, EYE, layout.targets, 0.1))
    assert [target.found for target in told.prediction.targets] == [True, True, False]
    assert "not_in_view" in {finding.code for finding in told.findings}
    np.testing.assert_allclose(told.prediction.without(2), told.prediction.sigma)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (set_key("targets", "T0", "facing_deg", value=0.0), "turned_away"),
        (set_key("targets", "T0", "center_m", value=[30.0, 0.0, 2.0]), "small_markers"),
    ],
)
def test_targets_that_will_not_be_found_are_named(
    tmp_path: Path, calibrate: Calibrate, change: Change, code: str
) -> None:
    assert f"warning: {code}:" in calibrate("plan", write(tmp_path, [FRONT, BACK, LEFT, RIGHT], change)).err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_key("targets", "T1", "tag", "id", value=0), "has the marker 0"),
        (set_key("targets", "T1", "facing_degrees", value=0), "did you mean 'facing_deg'?"),
        (
            set_key(
                "targets", "T1", "corners_m", value=dict.fromkeys(("top_left", "top_right", "bottom_left"), FRONT)
            ),
            "targets.T1: expected one of the keys corners_m and center_m",
        ),
        (set_key("corner_px", value=0.1), "expected one of the keys corner_px and corner_deg"),
        (lambda content: content.pop("forklift_from_camera"), "forklift_from_camera: is missing"),
    ],
)
def test_bad_layouts_are_one_line(tmp_path: Path, calibrate: Calibrate, change: Change, message: str) -> None:
    calibrate("plan", write(tmp_path, [FRONT, BACK, LEFT], change)).refuses(message)


def test_millimetres_are_told(tmp_path: Path, calibrate: Calibrate) -> None:
    corners = ("top_left", [3000, 100, 1700]), ("top_right", [3000, -100, 1700]), ("bottom_left", [3000, 100, 1500])
    tag = {"tag": TAG_SPEC | {"id": 0}, "corners_m": dict(corners), "sigma_m": 0.001}
    ended = calibrate("plan", write(tmp_path, [FRONT, BACK, LEFT], set_key("targets", "T0", value=tag)))
    assert ended.code == 1
    assert "fail: units:" in ended.err
