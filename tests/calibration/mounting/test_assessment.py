import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration import calibrate_mounting
from calibration.findings import Severity
from calibration.mounting.assessment import MountingAssessment, assess_mounting
from calibration.mounting.consensus import Reading, read_as
from calibration.mounting.fit import turn_to
from calibration.mounting.problem import MountingProblem, SurveyedTarget
from calibration.mounting.report import mounting_page
from calibration.result_page import write_result
from calibration.targets.targets import CharucoBoard, PrintedPattern, SingleTag, facing, patterns
from palletloc.cameras import Equirectangular
from palletloc.geometry import Image
from palletloc.io.camera_spec import transform_from_angles
from palletloc.io.recording import read_recording
from tests.calibration.expecting import Calibrate
from tests.calibration.simulated_yard import Yard, YardErrors, simulate_yard
from tests.calibration.yard_folder import CAMERA as YARD_CAMERA
from tests.calibration.yard_folder import CORNERS, Change, board_key, copied, render_yard, set_key, write

CAMERA = Equirectangular(3840, 1920)
BOARD = patterns(CharucoBoard(7, 5, 0.1, 0.075, "DICT_4X4_250"))[0]
TAG = patterns(SingleTag(0.2, "DICT_APRILTAG_36h11", 0))[0]
EYE = np.array([0.33, 0.09, 1.92])


def codes(assessment: MountingAssessment, *severities: Severity) -> list[str]:
    return [f.code for f in assessment.findings if not severities or f.severity in severities]


def edited(problem: MountingProblem, change: Callable[[int, SurveyedTarget], SurveyedTarget]) -> MountingProblem:
    return replace(problem, surveys=tuple(change(k, survey) for k, survey in enumerate(problem.surveys)))


def wall(places: Sequence[tuple[float, float]]) -> list[RigidTransform]:
    """Return boards flat on the wall x = 3, at these (y, z)."""
    into = facing(np.array([3.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])).rotation
    return [RigidTransform.from_components([3.0, y, z], into) for y, z in places]


def test_a_good_yard_passes_and_says_nothing(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    assessment = assess_mounting(drawn.problem, CAMERA)
    assert (assessment.exit_code, assessment.findings) == (0, ())
    assert assessment.solution is not None
    assert np.abs(assessment.solution.poses.camera.translation - drawn.truth.camera.translation).max() < 0.001
    assert [left.target for left in assessment.left_out] == [survey.name for survey in drawn.problem.surveys]
    assert max(np.abs(left.shift_in_sigma).max() for left in assessment.left_out) < 2.5


def ahead(x: float, y: float, z: float) -> RigidTransform:
    """Return a board at a place that is told from the camera."""
    return facing(EYE + np.array([x, y, z]), EYE, 0.1)


@pytest.mark.parametrize(
    ("pattern", "boards", "code"),
    [
        (BOARD, wall([(0.4, 1.8)]), "one_target"),
        (TAG, wall([(0.4, 1.8)]), "one_target"),
        (BOARD, wall([(-2.0, 1.0), (-1.0, 2.2), (0.5, 1.2), (2.0, 2.0)]), "one_wall"),
        (TAG, wall([(-2.0, 1.0), (-1.0, 2.2), (0.5, 1.2), (2.0, 2.0)]), "one_wall"),
        (TAG, wall([(-6.0, 1.5), (-3.0, 1.5), (0.0, 1.5), (3.0, 1.5), (6.0, 1.5)]), "collinear"),
        (TAG, [ahead(6.0 + k, 0.3 * k - 0.5, 0.2 * (k % 2)) for k in range(4)], "narrow_cone"),
    ],
)
def test_a_degenerate_layout_is_named(
    pattern: PrintedPattern, boards: list[RigidTransform], code: str, forklift_from_camera: RigidTransform
) -> None:
    drawn = simulate_yard(pattern, forklift_from_camera, boards)
    assessment = assess_mounting(drawn.problem, CAMERA)
    assert assessment.exit_code == 3
    assert codes(assessment, Severity.DEGENERATE) == [code]
    assert assessment.findings[0].how


def test_no_target_at_all_is_degenerate() -> None:
    assessment = assess_mounting(MountingProblem((), (), ()), CAMERA)
    assert (assessment.exit_code, codes(assessment)) == (3, ["no_target_seen"])


def test_targets_that_tell_little_give_no_confident_answer(forklift_from_camera: RigidTransform) -> None:
    boards = [ahead(4.0 + 2.0 * (k % 2), 1.8 * k - 2.0, 0.3 * k) for k in range(4)]
    errors = YardErrors(survey=0.01, bearing=1e-3)
    assessment = assess_mounting(simulate_yard(TAG, forklift_from_camera, boards, errors).problem, CAMERA)
    assert assessment.exit_code in (1, 3)
    assert {"too_uncertain", "unobservable"} & set(codes(assessment))


@pytest.mark.parametrize(("distance", "guilty"), [(0.006, 0), (0.03, 4), (0.3, 2)])
def test_a_moved_target_is_named(yard: Callable[..., Yard], distance: float, guilty: int) -> None:
    drawn = yard()
    step = distance * np.array([0.6, 0.0, 0.8])
    assessment = assess_mounting(
        edited(drawn.problem, lambda k, s: replace(s, points=s.points + step * (k == guilty))), CAMERA
    )
    found = [f for f in assessment.findings if f.severity is Severity.FAIL]
    assert assessment.exit_code == 1
    assert [f.code for f in found] == ["target_moved"]
    assert f"target B{guilty + 1} " in found[0].what


@pytest.mark.parametrize(
    ("order", "signs"),
    [((0, 1, 2), signs) for signs in ((1, -1, 1), (-1, 1, 1), (1, 1, -1))]
    + [(order, (1, 1, 1)) for order in ((1, 0, 2), (0, 2, 1), (2, 1, 0))],
)
def test_a_wrong_sign_and_swapped_axes_are_a_mirror(
    yard: Callable[..., Yard], order: tuple[int, int, int], signs: tuple[int, int, int]
) -> None:
    problem = edited(yard().problem, lambda _, s: replace(s, points=s.points[:, order] * signs))
    assert codes(assess_mounting(problem, CAMERA)) == ["mirrored_axes"]


@pytest.mark.parametrize(
    ("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres"), (0.001, "millimetres")]
)
def test_wrong_units_are_named(yard: Callable[..., Yard], factor: float, unit: str) -> None:
    assessment = assess_mounting(edited(yard().problem, lambda _, s: replace(s, points=s.points * factor)), CAMERA)
    assert (assessment.exit_code, codes(assessment)) == (1, ["units"])
    assert unit in assessment.findings[0].how


def test_a_survey_that_is_a_little_too_large_is_a_scale(yard: Callable[..., Yard]) -> None:
    assessment = assess_mounting(edited(yard().problem, lambda _, s: replace(s, points=s.points * 1.005)), CAMERA)
    assert codes(assessment, Severity.FAIL) == ["scale"]
    assert "+0.50 %" in assessment.findings[0].what


def test_a_board_printed_too_small_is_named(yard: Callable[..., Yard]) -> None:
    def shrink(k: int, survey: SurveyedTarget) -> SurveyedTarget:
        first = survey.points[0]
        return replace(survey, points=first + 0.96 * (survey.points - first)) if k == 1 else survey

    assessment = assess_mounting(edited(yard().problem, shrink), CAMERA)
    assert "target_size" in codes(assessment, Severity.FAIL)
    assert "target B2: the surveyed width is 0.67" in assessment.findings[0].what


def test_a_corner_that_is_not_square_is_named(yard: Callable[..., Yard]) -> None:
    def bend(k: int, survey: SurveyedTarget) -> SurveyedTarget:
        edge = survey.points[1] - survey.points[0]
        turned = survey.points[0] + Rotation.from_rotvec([0, 0, 0.1]).apply(edge)
        skewed = [survey.points[0], turned, survey.points[2] + 0.08 * edge]
        return replace(survey, points=np.array(skewed)) if k == 3 else survey

    assert "target_size" in codes(assess_mounting(edited(yard().problem, bend), CAMERA), Severity.FAIL)


@pytest.mark.parametrize(
    ("reading", "code", "exit_code"),
    [
        (Reading.UPSIDE_DOWN, "upside_down", 0),
        (Reading.LEFT_RIGHT, "corners_swapped", 1),
        (Reading.TOP_BOTTOM, "corners_swapped", 1),
    ],
)
def test_another_reading_of_the_corners_is_said(
    yard: Callable[..., Yard], reading: Reading, code: str, exit_code: int
) -> None:
    assessment = assess_mounting(edited(yard().problem, lambda k, s: read_as(s, reading) if k == 2 else s), CAMERA)
    assert (assessment.exit_code, codes(assessment)) == (exit_code, [code])
    assert "target B3" in assessment.findings[0].what


@pytest.mark.parametrize("distance", [0.01, 0.04])
def test_two_lens_centres_are_told_from_moved_targets(yard: Callable[..., Yard], distance: float) -> None:
    assessment = assess_mounting(yard(errors=YardErrors(lens_distance=distance)).problem, CAMERA)
    assert assessment.exit_code == 1
    assert "two_centres" in codes(assessment)
    assert "target_moved" not in codes(assessment)
    finding = next(f for f in assessment.findings if f.code == "two_centres")
    assert float(finding.what.split(" mm apart")[0].split()[-1]) == pytest.approx(1000 * distance, abs=1.0)


def test_targets_on_one_side_hide_the_second_centre_and_it_is_said(yard: Callable[..., Yard]) -> None:
    drawn = yard((0.3, -0.5, 1.0, -1.0, 0.0), errors=YardErrors(lens_distance=0.04))
    assessment = assess_mounting(drawn.problem, CAMERA)
    assert (assessment.exit_code, codes(assessment)) == (0, ["one_lens_side"])
    assert assessment.solution is not None
    assert "valid only for this lens side" in assessment.findings[0].what
    # The result is the front lens's own centre, 20 mm before the middle.
    moved = drawn.truth.camera.inv().apply(assessment.solution.poses.camera.translation)
    assert moved[0] == pytest.approx(0.02, abs=0.002)


def test_a_survey_worse_than_stated_is_said(yard: Callable[..., Yard]) -> None:
    drawn = yard(errors=YardErrors(survey=0.001))
    problem = edited(drawn.problem, lambda _, s: replace(s, sigma=0.0005))
    assessment = assess_mounting(problem, CAMERA)
    assert codes(assessment) == ["survey_sigma"]
    assert assessment.solution is not None
    off = turn_to(assessment.solution.poses.camera.rotation, drawn.truth.camera.rotation)
    assert (np.abs(off) < 4 * assessment.solution.sigma[3:]).all()


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
    assert read_recording(recording).camera == YARD_CAMERA


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
