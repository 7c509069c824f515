"""A drive past targets: what planar motion tells about the mounting, and that the rest is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from calibration.degeneracy import LIMITS
from calibration.motion.assessment import MotionAssessment, MotionResult, assess_motion
from calibration.motion.fit import lost_by_motion
from calibration.motion.problem import SCALE_PRIOR, Height, MotionProblem, MotionState
from calibration.motion.report import motion_page
from calibration.result_page import html_text
from calibration.targets.targets import PrintedPattern, facing, patterns
from palletloc.cameras import Equirectangular
from palletloc.geometry import FloatArray, Image
from palletloc.trajectory import Trajectory
from tests.calibration.expecting import Calibrate, present
from tests.calibration.simulated_drive import DriveErrors, drive_of, simulate_drive
from tests.calibration.simulated_yard import pose_error
from tests.calibration.yard_folder import board, board_key

BOARD = board(0)
STATED = RigidTransform.from_components([0.30, 0.05, 1.90], Rotation.identity())
STATED_SIGMA = np.array([0.05, 0.05, 0.05, *np.radians([3.0, 3.0, 3.0])])
SHOTS = 12
"""Few: each adds three unknowns."""
STRAIGHT, ARC, SPIN = ((6, 0.5, 0.0),), ((8, 0.4, 0.2),), ((8, 0.0, 0.3),)
BENDS, CURVE = ((5, 0.4, 0.3), (5, 0.4, -0.3)), ((3, 0.5, 0.0), (5, 0.4, 0.35), (3, 0.5, 0.0))
USUAL = DriveErrors()
Way = tuple[tuple[float, float, float], ...]


def boards_beside(way: Trajectory) -> list[tuple[PrintedPattern, RigidTransform]]:
    x, y = float(np.mean(way.x)), float(np.mean(way.y))
    pattern = patterns(BOARD)[0]
    return [
        (pattern, facing(np.array([x + dx, y + dy, z]), np.array([x, y, z])))
        for dx, dy, z in ((0.5, 2.5, 1.5), (2.9, -1.0, 1.2))
    ]


def simulated(
    camera: RigidTransform, way: Way, errors: DriveErrors = USUAL, stated: RigidTransform = STATED, *,
    height: bool = False, shots: int = SHOTS, seed: int = 0, scale_sigma: float = SCALE_PRIOR,
) -> MotionProblem:  # fmt: skip
    truth = drive_of(way)
    boards = boards_beside(truth)
    heights = {0: Height(float(boards[0][1].translation[2]), 0.003)} if height else {}
    return simulate_drive(
        truth, camera, boards, stated, errors, heights, shots=shots, seed=seed, scale_sigma=scale_sigma
    )


def assessed(camera: RigidTransform, way: Way, errors: DriveErrors, **more: Any) -> MotionAssessment:
    return assess_motion(simulated(camera, way, errors, **more), STATED_SIGMA)


def error(told: MotionAssessment, camera: RigidTransform) -> FloatArray:
    return pose_error(present(told.fit).state.camera, camera)


def square(told: MotionAssessment, camera: RigidTransform) -> tuple[float, int]:
    """Return the square of the error in the known directions over its covariance, and how many they are."""
    fit = present(told.fit)
    known, _ = fit.split()
    off = known.T @ (error(told, camera) / LIMITS)
    covariance = known.T @ (fit.covariance / np.outer(LIMITS, LIMITS)) @ known
    return float(off @ np.linalg.solve(covariance, off)), len(off)


@pytest.mark.parametrize(
    ("way", "lost", "named"),
    # On one arc the wheels' unknown scale hides the distance to its centre, too.
    [
        pytest.param(STRAIGHT, 4, "roll", marks=pytest.mark.slow),
        (ARC, 3, "yaw"),
        pytest.param(SPIN, 2, "yaw", marks=pytest.mark.slow),
        (BENDS, 1, ": z"),
        pytest.param(CURVE, 1, ": z", marks=pytest.mark.slow),
    ],
)
def test_lost_directions_are_named_and_the_rest_is_right(
    forklift_from_camera: RigidTransform, way: Way, lost: int, named: str
) -> None:
    told = assessed(forklift_from_camera, way, DriveErrors(scale=1.01, bias=0.004))
    assert told.exit_code == 3
    finding = next(finding for finding in told.findings if finding.code == "motion_lost")
    assert f"does not tell {lost} of 6 directions" in finding.what
    assert "z" in finding.what
    assert named in finding.what
    assert {4: "a straight drive", 3: "one arc", 2: "on the spot", 1: "a drive on the floor"}[lost] in finding.what
    sigma = present(told.fit).sigma
    known = sigma <= LIMITS
    assert not known[2]
    assert (np.abs(error(told, forklift_from_camera))[known] < 4 * sigma[known]).all()


@pytest.mark.parametrize(("way", "lost"), [(STRAIGHT, 4), (ARC, 2), (SPIN, 2), (BENDS, 1), (CURVE, 1)])
def test_what_commutes_with_all_motions_is_lost(forklift_from_camera: RigidTransform, way: Way, lost: int) -> None:
    problem = simulated(forklift_from_camera, way, DriveErrors(drawn=False))
    boards = np.stack([pose.as_matrix() for _, pose in boards_beside(drive_of(way))])
    kernel = lost_by_motion(problem, MotionState(forklift_from_camera, boards, problem.way()))
    assert kernel.shape[1] == lost
    up = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert np.linalg.norm(kernel.T @ up) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
def test_known_directions_are_consistent_over_many_drives(forklift_from_camera: RigidTransform) -> None:
    squares, freedom = [], 0
    for seed in range(30):
        errors = DriveErrors(scale=1.01, bias=0.004, delay=0.06)
        told = assessed(forklift_from_camera, BENDS if seed % 2 else CURVE, errors, seed=seed)
        off, known = square(told, forklift_from_camera)
        squares.append(off)
        freedom += known
    assert chi2.ppf(0.002, freedom) < sum(squares) < chi2.ppf(0.998, freedom)


def test_a_known_height_gives_all_six(forklift_from_camera: RigidTransform) -> None:
    told = assessed(forklift_from_camera, BENDS, DriveErrors(), height=True)
    fit = present(told.fit)
    assert fit.split()[1].shape[1] == 0
    assert fit.sigma[2] < 0.01
    assert (np.abs(error(told, forklift_from_camera)) < 4 * fit.sigma).all()


def test_faults_of_the_odometry_are_told(forklift_from_camera: RigidTransform) -> None:
    told = assessed(forklift_from_camera, BENDS, DriveErrors(scale=1.04, delay=0.3))
    fit = present(told.fit)
    scale, _, delay = fit.fault_sigma
    assert fit.state.scale == pytest.approx(1.04, abs=4 * scale)
    assert fit.state.delay == pytest.approx(0.3, abs=4 * delay)
    assert delay < 0.02
    assert {"time_offset", "wheel_scale"} <= {finding.code for finding in told.findings}


@pytest.mark.slow
def test_a_mounting_that_is_stated_wrongly_is_told(forklift_from_camera: RigidTransform) -> None:
    turned = RigidTransform.from_components([0.33, 0.09, 1.92], Rotation.from_euler("y", 4.0, degrees=True))
    for stated, told in ((turned, True), (forklift_from_camera, False)):
        assessment = assess_motion(simulated(forklift_from_camera, BENDS, stated=stated), np.full(6, 0.001))
        assert ("mounting_differs" in {finding.code for finding in assessment.findings}) == told


@pytest.mark.slow
def test_wheels_of_a_known_scale_tell_the_distance_to_an_arcs_centre(forklift_from_camera: RigidTransform) -> None:
    free = assessed(forklift_from_camera, ARC, DriveErrors(scale=1.002))
    known = assessed(forklift_from_camera, ARC, DriveErrors(scale=1.002), scale_sigma=0.003)
    told = [next(finding for finding in each.findings if finding.code == "motion_lost") for each in (free, known)]
    assert "wheels' scale" in told[0].what
    assert "wheel_scale" in told[0].how
    assert "does not tell 2 of 6" in told[1].what
    assert "wheels' scale" not in told[1].what
    off, freedom = square(known, forklift_from_camera)
    assert off < chi2.ppf(0.999, freedom)


@pytest.mark.parametrize(
    ("way", "length"),
    [
        pytest.param(BENDS, 0.05, marks=pytest.mark.slow),
        (BENDS, 0.4),
        pytest.param(ARC, 0.15, marks=pytest.mark.slow),
    ],
)
def test_a_slip_of_the_wheels_is_named_or_does_no_harm(
    forklift_from_camera: RigidTransform, way: Way, length: float
) -> None:
    told = assessed(forklift_from_camera, way, DriveErrors(slips=((4.3, length),)))
    off, freedom = square(told, forklift_from_camera)
    assert off < chi2.ppf(0.999, freedom)
    if length > 0.1:
        assert {"slip", "odometry_sigma"} & {finding.code for finding in told.findings}


def test_the_report_draws_the_way_and_names_what_is_told(forklift_from_camera: RigidTransform) -> None:
    told = assessed(forklift_from_camera, BENDS, DriveErrors())
    assert present(told.fit).split()[1].shape[1] == 1
    page = html_text(motion_page(MotionResult(told, Equirectangular(1280, 640))))
    assert page.count(">lost</td>") == 1
    assert page.count(">told</td>") == 5
    assert page.count("<img ") == 1


def test_few_shots_are_refused(forklift_from_camera: RigidTransform) -> None:
    told = assessed(forklift_from_camera, BENDS, DriveErrors(), shots=4)
    assert (told.exit_code, told.findings[0].code) == (3, "few_sights")


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image], forklift_from_camera: RigidTransform
) -> Path:
    """Return a recording of a drive past one board."""
    folder = tmp_path_factory.mktemp("drive")
    truth = drive_of(CURVE)
    place = boards_beside(truth)[0][1]
    shots = ["time_s,file"]
    for index, time in enumerate(np.linspace(1.0, truth.times[-1] - 1.0, 8)):
        pose = truth.pose_at(float(time))
        odom = RigidTransform.from_components([pose.x, pose.y, 0.0], Rotation.from_euler("z", pose.yaw))
        shot = render(Equirectangular(1280, 640), [(BOARD, (odom * forklift_from_camera).inv() * place)])
        cv2.imwrite(str(folder / f"{index}.png"), shot)
        shots.append(f"{time:.6f},{index}.png")
    (folder / "shots.csv").write_text("\n".join(shots) + "\n")
    rows = [f"{t:.4f},{x:.7f},{y:.7f},{w:.8f},0,0" for t, x, y, w in zip(
        truth.times, truth.x, truth.y, truth.yaw, strict=True)]  # fmt: skip
    (folder / "odometry.csv").write_text("time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps\n" + "\n".join(rows) + "\n")
    content = {
        "format": 1,
        "camera": {"model": "equirectangular", "width": 1280, "height": 640},
        "forklift_from_camera": {"translation_m": [0.30, 0.05, 1.90], "roll_pitch_yaw_deg": [0, 0, 0],
                                 "translation_sigma_m": [0.1, 0.1, 0.1], "rotation_sigma_deg": [3, 3, 3]},
        "shelf": {"point_m": [3.0, 1.8], "facing_deg": -90.0},
        "pallets": ["epal1-1200"],
    }  # fmt: skip
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    (folder / "targets.yaml").write_text(yaml.safe_dump({"format": 1, "targets": {"B": board_key(0)}}))
    return folder


def test_a_recording_is_checked(recording: Path, tmp_path: Path, calibrate: Calibrate) -> None:
    out = tmp_path / "rig.yaml"
    ended = calibrate("extrinsics", "--motion", recording, "--out", out)
    assert ended.code == 3
    assert "degenerate: motion_lost:" in ended.err
    assert "not told" in ended.out
    assert not out.exists()
    data = json.loads((tmp_path / "rig.failed.json").read_text())
    assert data["found_minus_stated"][2] is None
    # The true mounting is turned by -0.9 and 1.2 degrees against the stated one.
    assert np.degrees(data["found_minus_stated"][3:5]) == pytest.approx([-0.9, 1.2], abs=0.1)


def test_a_recording_without_targets_is_one_line(recording: Path, tmp_path: Path, calibrate: Calibrate) -> None:
    place = tmp_path / "other"
    place.mkdir()
    for name in ("recording.yaml", "shots.csv", "odometry.csv"):
        (place / name).write_text((recording / name).read_text())
    calibrate("extrinsics", "--motion", place, "--out", "rig.yaml").refuses("targets.yaml")
