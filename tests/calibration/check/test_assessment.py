import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calibration.check.assessment import assess_check
from calibration.check.mounting import MountingCheck, NamedYaw
from calibration.check.report import check_page
from calibration.check.tilt_sources import FLOOR, LEVELS, VERTICALS, Absent, Contradiction, NamedTilt
from calibration.findings import DEGENERATE, FAIL, PASS
from calibration.result_page import json_text
from calibration.shelf.gravity_lines import Tilt
from palletloc.io.camera_spec import angles_from_transform, transform_from_angles
from palletloc.io.recording import RECORDING, read_recording
from tests.calibration.expecting import Calibrate

SAMPLE = Path(__file__).resolve().parents[3] / "palletloc" / "sample"
DATA = Path(__file__).resolve().parents[3].parent / "shared/data"
TOLERANCE = float(np.radians(0.15))


def checked(
    roll: float, pitch: float, *, sigma: tuple[float, float] = (0.03, 0.03), chance: float = 1.0,
    yaw: tuple[float, float] = (0.0, 0.2), yaws: tuple[float, ...] = (), height: tuple[float, float] | None = None,
) -> MountingCheck:  # fmt: skip
    """Return what a check found; all angles in degrees."""
    covariance = np.diag(np.radians(sigma)) ** 2
    tilt = Tilt(-np.radians([roll, pitch]), np.linalg.inv(covariance), 100)
    tilts = (NamedTilt(VERTICALS, tilt), NamedTilt(LEVELS, tilt))
    turned = float(np.radians(yaw[0])), float(np.radians(yaw[1]))
    worst = Contradiction(VERTICALS, LEVELS, chance)
    told = tuple(NamedYaw(f"kind {i}", float(np.radians(turn)), 0.005) for i, turn in enumerate(yaws))
    return MountingCheck(
        read_recording(SAMPLE), (), tilts, np.radians([roll, pitch]), covariance, chance, turned, None, (), worst,
        told, height,
    )  # fmt: skip


def codes(check: MountingCheck) -> tuple[int, set[str]]:
    assessment = assess_check(check, TOLERANCE)
    return assessment.exit_code, {finding.code for finding in assessment.findings}


def test_a_camera_in_its_place_passes() -> None:
    assert codes(checked(0.02, -0.05)) == (PASS, set())


@pytest.mark.parametrize(
    ("check", "code"),
    [
        (checked(0.3, 0.0), "roll_drift"),
        (checked(0.0, -0.25), "pitch_drift"),
        (checked(0.0, 0.0, chance=1e-4), "methods_disagree"),
        (checked(0.0, 0.0, yaw=(-1.5, 0.3)), "yaw_drift"),
        (checked(0.0, 0.0, height=(0.03, 0.005)), "height_drift"),
    ],
)
def test_each_fault_fails_under_its_own_name(check: MountingCheck, code: str) -> None:
    assert codes(check) == (FAIL, {code})


def test_a_turn_within_its_own_doubt_does_not_fail() -> None:
    assert codes(checked(0.2, 0.0, sigma=(0.15, 0.15)))[0] == PASS
    assert codes(checked(0.0, 0.0, yaw=(0.8, 0.5)))[0] == PASS
    assert codes(checked(0.0, 0.0, height=(0.02, 0.01)))[0] == PASS


def test_landmarks_that_contradict_each_other_about_the_yaw_are_named() -> None:
    assert codes(checked(0.0, 0.0, yaws=(0.0, 3.0))) == (PASS, {"yaws_disagree"})
    assert codes(checked(0.0, 0.0, yaws=(0.0, 0.5))) == (PASS, set())


def test_a_source_that_says_nothing_is_named() -> None:
    check = replace(checked(0.0, 0.0), absent=(Absent(FLOOR, "no line is seen"),))
    assert codes(check) == (PASS, {"source_absent"})
    assert FLOOR in assess_check(check, TOLERANCE).findings[0].what
    data = json.loads(json_text(check_page(assess_check(check, TOLERANCE))))
    assert data["absent"][0]["method"] == FLOOR


def test_an_axis_that_nothing_tells_is_named() -> None:
    check = checked(0.0, 0.0, sigma=(0.03, 2.0))
    assert codes(check) == (DEGENERATE, {"one_axis_open"})
    assert "pitch" in assess_check(check, TOLERANCE).findings[0].what


def test_a_recording_without_any_source_is_degenerate() -> None:
    nothing = MountingCheck(read_recording(SAMPLE), (), (), None, np.zeros((2, 2)), 1.0, None, None)
    assert codes(nothing) == (DEGENERATE, {"nothing_seen"})


def test_the_mounting_that_fits_better_undoes_the_turn() -> None:
    check = checked(0.4, -0.3)
    stated = check.recording.forklift_from_camera.rotation
    turned = Rotation.from_rotvec(np.radians([0.4, -0.3, 0.0])) * stated
    assert (check.corrected().rotation * turned.inv()).magnitude() < 1e-9


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not there")
@pytest.mark.parametrize("name", ["dev_lab", "dev_warehouse"])
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, 0.0), (0.0, -0.5), (1.0, 0.0)])
def test_a_turned_mounting_is_found_and_a_right_one_passes(
    name: str, roll: float, pitch: float, tmp_path: Path, calibrate: Calibrate
) -> None:
    place = tmp_path / name
    shutil.copytree(DATA / name, place, ignore=shutil.ignore_patterns("truth"))
    content = yaml.safe_load((place / RECORDING).read_text())
    mounting = content["forklift_from_camera"]
    stated = transform_from_angles(tuple(mounting["translation_m"]), tuple(mounting["roll_pitch_yaw_deg"]))
    turn = Rotation.from_rotvec(np.radians([roll, pitch, 0.0]))
    turned = type(stated).from_components(stated.translation, turn * stated.rotation)
    mounting["roll_pitch_yaw_deg"] = list(angles_from_transform(turned)[1])
    (place / RECORDING).write_text(yaml.safe_dump(content))
    out = tmp_path / "check.html"
    assert calibrate("check", place, "--out", out).code == (1 if roll or pitch else 0)
    found = json.loads(out.with_suffix(".json").read_text())
    for axis, expected in (("roll", -roll), ("pitch", -pitch)):
        off = abs(found["turned_deg"][axis] - expected)
        assert off < min(0.08, 2.5 * found["sigma_deg"][axis])
    sources = {source["method"]: source for source in found["methods"]}
    for source in sources.values():
        for axis, sigma, expected in zip(("roll", "pitch"), source["sigma_deg"], (-roll, -pitch), strict=True):
            assert sigma is None or abs(source[f"{axis}_deg"] - expected) < 3 * sigma
    assert sources["pallets"]["sigma_deg"][1] < 0.1
    assert abs(found["height_mm"]) < 3 * found["height_sigma_mm"]
