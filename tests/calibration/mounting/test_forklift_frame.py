"""The camera's pose from a survey of targets and forklift in the total station's own frame."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.mounting.consensus import agree
from calibration.mounting.fit import fit_mounting
from calibration.mounting.forklift_frame import ForkliftFrame, frame_from_points, frame_from_wheels
from calibration.targets.targets import CharucoBoard
from palletloc.geometry import FloatArray, Image
from palletloc.io.camera_spec import transform_from_angles
from palletloc.survey.point import Survey, SurveyPoint
from tests.calibration.expecting import Calibrate, present
from tests.calibration.simulated_yard import Yard, YardErrors, assert_consistent, pose_error
from tests.calibration.yard_folder import CORNERS, board_key, copied, render_yard, set_key, write
from tests.palletloc.survey.gsi_writer import point_block, write_gsi

WORLD_FROM_FORKLIFT = RigidTransform.from_components(
    [512.3, 1043.7, 98.2], Rotation.from_euler("ZYX", [118.0, 0.4, -0.3], degrees=True)
)
PRISMS = {"V1": [-0.9, 0.45, 2.10], "V2": [-0.9, -0.45, 2.08], "V3": [0.55, -0.40, 1.20], "V4": [0.7, 0.5, 0.6]}
FLOOR = {"F1": [1.5, 1.2, 0.0], "F2": [1.5, -1.2, 0.0], "F3": [-1.4, 1.1, 0.0], "F4": [-1.4, -1.3, 0.0]}
WHEELS = {"WL": [0.0, 0.55, 0.31], "WR": [0.0, -0.55, 0.31]}
SIGMA = 0.0006


def survey_of(places: dict[str, list[float]], rng: np.random.Generator | None = None) -> Survey:
    """Return the points as a total station would give them."""
    points = {}
    for line, (name, place) in enumerate(places.items(), 1):
        noise = np.zeros(3) if rng is None else rng.normal(0, SIGMA, 3)
        points[name] = SurveyPoint(name, WORLD_FROM_FORKLIFT.apply(np.array(place)) + noise, (line,))
    return Survey(Path("survey.csv"), points)


def by_points(survey: Survey) -> ForkliftFrame:
    return frame_from_points(survey, {name: np.array(place) for name, place in PRISMS.items()}, SIGMA)


def by_wheels(survey: Survey) -> ForkliftFrame:
    # The simulated floor is as even as the survey can tell.
    return frame_from_wheels(survey, tuple(FLOOR), ("WL", "WR"), SIGMA, 1e-9)


METHODS = pytest.mark.parametrize("method", [by_points, by_wheels])


@METHODS
def test_exact_points_give_the_frame(method: Callable[[Survey], ForkliftFrame]) -> None:
    frame = method(survey_of(PRISMS | FLOOR | WHEELS))
    assert frame.pose is not None
    off = frame.pose.target_from_source.inv() * WORLD_FROM_FORKLIFT
    assert np.abs(off.translation).max() < 1e-8
    assert off.rotation.magnitude() < 1e-8
    assert frame.findings == ()


@METHODS
def test_errors_of_the_frame_are_as_stated(method: Callable[[Survey], ForkliftFrame]) -> None:
    squares = []
    for seed in range(100):
        pose = present(method(survey_of(PRISMS | FLOOR | WHEELS, np.random.default_rng(seed))).pose)
        off = pose_error(pose.target_from_source, WORLD_FROM_FORKLIFT)
        squares.append(float(off @ np.linalg.solve(pose.covariance, off)))
    assert_consistent(squares)


@pytest.mark.slow
@METHODS
def test_the_cameras_covariance_is_consistent(
    yard: Callable[..., Yard], method: Callable[[Survey], ForkliftFrame]
) -> None:
    squares = []
    for seed in range(240):
        small = CharucoBoard(4, 3, 0.12, 0.09, "DICT_4X4_250")
        drawn = yard((0.4, 2.0, -2.6, -1.2), seed, YardErrors(survey=SIGMA, bearing=1e-4), small)
        frame = method(survey_of(PRISMS | FLOOR | WHEELS, np.random.default_rng([seed, 7])))
        assert frame.pose is not None
        shift = frame.pose.target_from_source.inv() * WORLD_FROM_FORKLIFT
        surveys = tuple(replace(survey, points=shift.apply(survey.points)) for survey in drawn.problem.surveys)
        start = present(agree(replace(drawn.problem, surveys=surveys)))
        bare = fit_mounting(start.problem, start.poses)
        solution = bare.with_frame_errors(frame.camera_covariance(bare.poses.camera))
        off = pose_error(solution.poses.camera, drawn.truth.camera)
        squares.append(float(off @ np.linalg.solve(solution.covariance, off)))
    assert_consistent(squares)


@pytest.fixture(scope="module")
def folder(
    tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image], forklift_from_camera: RigidTransform
) -> Path:
    """Return a folder with a shot of four boards, and a survey of them and of the forklift."""
    folder = tmp_path_factory.mktemp("yard")
    forklift = PRISMS | FLOOR | WHEELS | {"AHEAD": [1.8, 0.2, 0.4]}
    places = {name: np.array(place) for name, place in forklift.items()}
    targets, named = {}, {}
    for k, corners in enumerate(render_yard(folder, render, forklift_from_camera)):
        named[f"B{k}"] = {key: f"P{k}{i}" for i, key in enumerate(CORNERS)}
        places |= {f"P{k}{i}": corner for i, corner in enumerate(corners)}
        targets[f"B{k}"] = board_key(k)
    rng = np.random.default_rng(1)
    world = {name: WORLD_FROM_FORKLIFT.apply(place) + rng.normal(0, SIGMA, 3) for name, place in places.items()}
    table(folder / "survey.csv", world)
    write_gsi(folder / "survey.gsi", [point_block(i, name, at) for i, (name, at) in enumerate(world.items(), 1)])
    survey = {"file": "survey.csv", "sigma_m": SIGMA, "targets": named, "frame": MEASURED}
    write(folder, {"targets": targets, "survey": survey})
    return folder


MEASURED = {"method": "measured_points", "points": PRISMS}
MARKS = {
    "method": "wheel_marks", "floor": list(FLOOR), "left_wheel": "WL", "right_wheel": "WR", "ahead": "AHEAD"
}  # fmt: skip


def table(path: Path, world: dict[str, FloatArray]) -> None:
    rows = [f"{name},{x:.6f},{y:.6f},{z:.6f}\n" for name, (x, y, z) in world.items()]
    path.write_text("name,x_m,y_m,z_m\n" + "".join(rows))


def points_in(path: Path) -> dict[str, FloatArray]:
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    return {name: np.array([float(v) for v in values]) for name, *values in rows}


Change = Callable[[dict[str, Any], dict[str, FloatArray]], object]


def variant(folder: Path, place: Path, change: Change) -> Path:
    """Return a copy of the folder with another survey or another extrinsics.yaml."""
    content, world = copied(folder, place, ("shot.png", "survey.gsi")), points_in(folder / "survey.csv")
    change(content, world)
    table(place / "survey.csv", world)
    write(place, content)
    return place


def key(*keys: str, value: object) -> Change:
    return lambda content, _: set_key(*keys, value=value)(content)


def frame(**keys: object) -> Change:
    return key("survey", "frame", value=keys)


@pytest.mark.parametrize("change", [frame(**MEASURED), frame(**MARKS), key("survey", "file", value="survey.gsi")])
def test_a_survey_in_the_world_gives_a_rig(
    folder: Path, tmp_path: Path, forklift_from_camera: RigidTransform, change: Change, calibrate: Calibrate
) -> None:
    yard = variant(folder, tmp_path / "yard", change)
    assert calibrate("extrinsics", yard, "--out", tmp_path / "rig.yaml").code == 0
    rig = yaml.safe_load((tmp_path / "rig.yaml").read_text())["forklift_from_camera"]
    found = transform_from_angles(rig["translation_m"], rig["roll_pitch_yaw_deg"])
    moved = np.abs(found.translation - forklift_from_camera.translation)
    turned = np.degrees(np.abs((found.rotation * forklift_from_camera.rotation.inv()).as_rotvec()))
    assert (moved < 4 * np.array(rig["translation_sigma_m"])).all()
    assert moved.max() < 0.004
    assert (turned < 4 * np.array(rig["rotation_sigma_deg"])).all()
    data = json.loads((tmp_path / "rig.json").read_text())
    assert len(data["forklift_frame"]["residual_m"]) == 4
    assert np.linalg.eigvalsh(data["frame_covariance"]).min() > 0
    assert "The forklift in the survey" in (tmp_path / "rig.html").read_text()


def points(moved: Callable[[FloatArray], FloatArray], *names: str) -> Change:
    """Return what moves the points whose names begin so; all of them without a name."""

    def change(_: dict[str, Any], world: dict[str, FloatArray]) -> None:
        world |= {name: moved(place) for name, place in world.items() if name.startswith(names or "")}

    return change


def raised(name: str, by: float) -> Change:
    return points(lambda place: place + np.array([0.0, 0.0, by]), name)


def thousandfold(place: FloatArray) -> FloatArray:
    return 1000 * place


MIRRORED = points(lambda place: place[[1, 0, 2]])


def together(*changes: Change) -> Change:
    def change(content: dict[str, Any], world: dict[str, FloatArray]) -> None:
        for each in changes:
            each(content, world)

    return change


def on_wheels(**keys: object) -> Change:
    return frame(**(MARKS | keys))


def only(*names: str) -> Change:
    return frame(method="measured_points", points={name: PRISMS[name] for name in names})


def rows(points: dict[str, list[float]]) -> Change:
    """Place points of the forklift and say so."""

    def change(content: dict[str, Any], world: dict[str, FloatArray]) -> None:
        content["survey"]["frame"] = {"method": "measured_points", "points": points}
        world |= {name: WORLD_FROM_FORKLIFT.apply(np.array(place)) for name, place in points.items()}

    return change


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        (points(thousandfold), 1, "in millimetres, expected metres"),
        (points(thousandfold, *PRISMS), 1, "in millimetres, expected metres"),
        (together(on_wheels(), points(thousandfold)), 1, "give all coordinates in metres"),
        (MIRRORED, 1, "mirrored_axes: "),
        (together(only("V1", "V2", "V3"), MIRRORED), 1, "mirrored"),
        (together(frame(**{k: v for k, v in MARKS.items() if k != "ahead"}), MIRRORED), 1, "mirrored_axes: "),
        (on_wheels(left_wheel="WR", right_wheel="WL"), 1, "are WR and WL swapped"),
        (raised("B", 0.0), 0, ""),
        (raised("P2", 0.02), 1, "target_moved: target B2"),
        (raised("V3", 0.02), 1, "point 'V3' does not fit the others"),
        (raised("V3", 0.0), 0, ""),
        (together(on_wheels(), raised("F3", 0.03)), 1, "point_moved: point 'F"),
        (only("V1", "V2"), 3, "frame_points: 2 points on the forklift"),
        (rows({"Q1": [0, 0, 1], "Q2": [0.5, 0, 1], "Q3": [1, 0, 1]}), 3, "on one straight line"),
        (on_wheels(floor=["F1", "F2"]), 3, "frame_points: 2 points on the floor"),
        (on_wheels(left_wheel="F9"), 1, "no point 'F9'"),
        (on_wheels(left_wheel="WR"), 1, "left_wheel and right_wheel are both 'WR'"),
        (frame(method="wheels"), 1, "survey.frame"),
    ],
)
def test_faults_of_the_survey_are_named(
    folder: Path, tmp_path: Path, calibrate: Calibrate, change: Change, code: int, message: str
) -> None:
    ended = calibrate("extrinsics", variant(folder, tmp_path / "bad", change), "--out", tmp_path / "rig.yaml")
    assert ended.code == code
    assert message in ended.err
    assert (tmp_path / "rig.yaml").exists() == (code == 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (key("survey", "targets", "B1", "top_left", value="P10x"), "survey.csv: no point 'P10x'"),
        (key("survey", "targets", "B1", "top_left", value="P00"), "survey.targets: point 'P00' stands there twice"),
        (
            lambda content, _: content["survey"]["targets"].update(B7=content["survey"]["targets"].pop("B1")),
            "survey.targets: unknown target 'B7'",
        ),
        (lambda content, _: content["survey"]["targets"].pop("B1"), "targets.B1.corners_m: is missing"),
        (key("targets", "B1", "sigma_m", value=0.001), "targets.B1: expected neither corners_m nor sigma_m"),
    ],
)
def test_names_that_do_not_fit_are_one_line(
    folder: Path, tmp_path: Path, calibrate: Calibrate, change: Change, message: str
) -> None:
    wrong = variant(folder, tmp_path / "bad", change)
    calibrate("extrinsics", wrong, "--out", tmp_path / "rig.yaml").refuses(message)
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]
