import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from palletloc.evaluation.truth import continuous_poses
from palletloc.geometry import LevelPose
from palletloc.io.truth import TruePallet, read_truth
from palletloc.survey.plan import SurveyPlan, read_survey_plan
from palletloc.survey.point import Survey, SurveyPoint
from palletloc.survey.truth import TruePose, read_surveyed_truth, survey_truth
from palletloc.trajectory import Trajectory

Points = Mapping[str, list[float]]


def as_survey(points: Points, noise: np.random.Generator | None = None, sigma: float = 0.0) -> Survey:
    """Return a survey of points, with noise."""
    named = {}
    for number, (name, place) in enumerate(points.items(), start=1):
        error = noise.normal(0, sigma, 3) if noise else np.zeros(3)
        named[name] = SurveyPoint(name, np.array(place) + error, (number,))
    return Survey(Path("survey.csv"), named)


def plan_of(lab: Path, old: str = "", new: str = "") -> SurveyPlan:
    path = lab / "truth" / "survey.yaml"
    path.write_text(path.read_text().replace(old, new))
    return read_survey_plan(path)


def test_a_survey_gives_the_pose_of_every_pallet_at_every_stop_and_how_well_each_heading_is_known(
    lab: Path, lab_truth: dict[tuple[str, str], LevelPose]
) -> None:
    truth = read_surveyed_truth(lab)
    found = {(stop.name, pose.id): pose for stop in truth.stops for pose in stop.poses}
    assert found.keys() == lab_truth.keys()
    for key, pose in found.items():
        error = np.abs(pose.forklift_from_pallet.as_array() - lab_truth[key].as_array())
        assert (error < [1e-3, 1e-3, 1e-3, 3e-4]).all()
        assert np.linalg.eigvalsh(pose.covariance).min() > 0
    assert [stop.time for stop in truth.stops] == [1.0, 3.0]
    assert truth.notes == ()
    assert re.fullmatch(
        r"body 'A': 3 points of 0\.6 mm, residual 0\.\d+ mm, heading known to 0\.04\d* degrees, tilt measured",
        truth.pallets[0].statement,
    )
    assert truth.stops[1].forklift.statement.startswith("stop 'S2': 3 points")


@pytest.mark.parametrize("level", [False, True])
def test_the_stated_covariance_is_true(
    lab: Path, lab_points: Points, lab_truth: dict[tuple[str, str], LevelPose], rng: np.random.Generator, level: bool
) -> None:
    plan = plan_of(lab, "file:", "level: true\nfile:") if level else plan_of(lab)
    count, total = 100, dict.fromkeys(lab_truth, 0.0)
    for _ in range(count):
        for stop in survey_truth(plan, as_survey(lab_points, rng, plan.sigma)).stops:
            for pose in stop.poses:
                total[stop.name, pose.id] += pose.nees(lab_truth[stop.name, pose.id])
    low, high = (float(chi2.ppf(tail, 4 * count)) for tail in (0.0005, 0.9995))
    assert all(low < value < high for value in total.values()), total


def test_a_sigma_that_is_too_small_is_found_out_and_put_right(
    lab: Path, lab_points: Points, rng: np.random.Generator
) -> None:
    plan = plan_of(lab, "sigma_m: 0.0006", "sigma_m: 0.0002")
    survey = as_survey(lab_points, rng, 0.0008)
    truth = survey_truth(plan, survey)
    assert truth.variance_factor > 4
    (note,) = truth.notes
    assert "sigma_m: the residuals of all bodies say" in note
    right = survey_truth(plan_of(lab, "sigma_m: 0.0002", "sigma_m: 0.0008"), survey)
    ratio = truth.stops[0].poses[0].yaw_sigma / right.stops[0].poses[0].yaw_sigma
    assert ratio == pytest.approx(np.sqrt(truth.variance_factor) / 4)
    assert 0.6 < ratio < 1.5


def test_two_targets_suffice_for_a_level_body_and_that_and_points_of_no_target_are_said(
    lab: Path, lab_points: Points, lab_truth: dict[tuple[str, str], LevelPose]
) -> None:
    points = {name: place for name, place in lab_points.items() if name not in ("V3-S1", "A-UL")}
    truth = survey_truth(plan_of(lab), as_survey(points))
    for pose in truth.stops[0].poses:
        expected = lab_truth["S1", pose.id].as_array()
        assert_allclose(pose.forklift_from_pallet.as_array(), expected, atol=1e-9)
    assert "stop 'S1': has 2 points and is taken to stand level" in truth.notes
    assert "survey.csv: body 'A' lacks A-UL" in truth.notes
    assert "taken to be level" in truth.pallets[0].statement
    truth = survey_truth(plan_of(lab), as_survey({**lab_points, "K7": [0.0, 0.0, 0.0]}))
    assert truth.notes == ("survey.csv: point 'K7' (line 13) is no target",)


def test_tilt_of_the_floor_is_followed(lab: Path, lab_points: Points) -> None:
    """A vehicle that leans by a degree sees the pallets elsewhere; a level fit of it would not."""
    lean = np.radians(1.0)
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    points = {name: (turn @ place).tolist() if "-S" in name else place for name, place in lab_points.items()}
    truth = survey_truth(plan_of(lab), as_survey(points))
    assert truth.stops[0].forklift.fit.pose.tilt == pytest.approx(lean, rel=1e-6)


def test_a_continuous_truth_gives_poses_without_covariance() -> None:
    path = Trajectory(np.array([0.0, 1.0]), np.array([0.0, 2.0]), np.zeros(2), np.zeros(2))
    (pose,) = continuous_poses(path, [TruePallet("A", "t11", LevelPose(4.0, 2.0, 0.1, 1.5))], 0.5)
    assert pose.id == "A"
    assert_allclose(pose.forklift_from_pallet.as_array(), [3.0, 2.0, 0.1, 1.5])
    assert not pose.covariance.any()


def test_errors_are_normalized_by_both_uncertainties() -> None:
    true = TruePose("A", LevelPose(1.0, 2.0, 0.0, 3.1), np.diag([9.0, 1.0, 1.0, 1e-4]))
    measured = LevelPose(6.0, 2.0, 1.0, -3.1)
    own = np.diag([16.0, 0.0, 3.0, 0.0])
    error = 2 * (np.pi - 3.1)
    assert_allclose(true.normalised_error(measured, own), [1.0, 0.0, 0.5, error / 0.01])
    assert true.nees(measured, own) == pytest.approx(1 + 0.25 + (error / 0.01) ** 2)


def test_the_survey_of_a_shared_recording_agrees_with_its_truth(shared_data: Path) -> None:
    folder = shared_data / "dev_lab"
    surveyed, truth = read_surveyed_truth(folder), read_truth(folder)
    errors = []
    for stop in surveyed.stops:
        poses = {pose.id: pose for pose in continuous_poses(truth.forklift, truth.pallets, stop.time)}
        errors += [pose.normalised_error(poses[pose.id].forklift_from_pallet) for pose in stop.poses]
    assert np.shape(errors) == (9, 4)
    assert np.abs(errors).max() < 2
    assert surveyed.notes == ()


def test_angles_and_distances_alone_give_the_same_truth_as_coordinates(shared_data: Path, tmp_path: Path) -> None:
    """Polar lines live in a frame of their own, and in GSI-8, with carriage returns alone; none of it matters."""
    folder = shared_data / "dev_lab" / "truth"
    lines = []
    for line in (folder / "survey.gsi").read_text().splitlines():
        name, *polar = line.lstrip("*").split()[:4]
        lines.append(" ".join([name[:7] + name[-8:], *(word[:7] + word[-8:] for word in polar)]))
    (truth := tmp_path / "truth").mkdir()
    (truth / "survey.gsi").write_bytes(b"\xef\xbb\xbf" + "\r".join(lines).encode())
    (truth / "survey.yaml").write_text((folder / "survey.yaml").read_text())
    polar_truth, given = read_surveyed_truth(tmp_path), read_surveyed_truth(shared_data / "dev_lab")
    for stop, other in zip(polar_truth.stops, given.stops, strict=True):
        for pose, expected in zip(stop.poses, other.poses, strict=True):
            assert np.abs(expected.normalised_error(pose.forklift_from_pallet)).max() < 0.5


@pytest.mark.parametrize("name", ["dev_lab", "dev_warehouse"])
def test_a_survey_made_from_a_shared_truth_gives_it_back(
    shared_data: Path, name: str, rng: np.random.Generator, lab: Path
) -> None:
    truth = read_truth(shared_data / name)
    lift = plan_of(lab).bodies["forklift"]
    front = {"LL": [0.0, 0.4, 0.01], "LR": [0.0, -0.4, 0.01], "UL": [0.0, 0.4, 0.13]}
    times = np.linspace(*truth.forklift.span, 4)
    text = "file: survey.csv\nsigma_m: 0.001\nstops:\n"
    text += "".join(f"- {{name: S{number}, time_s: {time}}}\n" for number, time in enumerate(times))
    text += "bodies:\n  forklift: " + repr({key: place.tolist() for key, place in lift.items()}) + "\n"
    points: dict[str, list[float]] = {}
    for number, time in enumerate(times):
        pose = truth.forklift.pose_at(float(time)).transform()
        points |= {f"{key}-S{number}": pose.apply(place).tolist() for key, place in lift.items()}
    for pallet in truth.pallets:
        own = {f"{pallet.id}-{key}": place for key, place in front.items()}
        text += f"  {pallet.id}: {own!r}\n"
        pose = pallet.world_from_pallet.transform()
        points |= {key: pose.apply(place).tolist() for key, place in own.items()}
    (lab / "truth" / "survey.yaml").write_text(text)
    found = survey_truth(plan_of(lab), as_survey(points, rng, 0.001))
    nees = []
    for stop in found.stops:
        exact = {pose.id: pose for pose in continuous_poses(truth.forklift, truth.pallets, stop.time)}
        nees += [pose.nees(exact[pose.id].forklift_from_pallet) for pose in stop.poses]
    # Poses at one stop share the forklift's error, so their mean scatters more than independent ones would.
    assert 1 < np.mean(nees) < 9
