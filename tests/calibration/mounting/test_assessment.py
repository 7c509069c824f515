from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.findings import Severity
from calibration.mounting.assessment import MountingAssessment, assess_mounting
from calibration.mounting.consensus import Reading, read_as
from calibration.mounting.fit import turn_to
from calibration.mounting.problem import MountingProblem, SurveyedTarget
from calibration.targets.targets import CharucoBoard, PrintedPattern, SingleTag, facing, patterns
from palletloc.cameras import Equirectangular
from tests.calibration.simulated_yard import Yard, YardErrors, simulate_yard

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
