"""What each source tells of the tilt within what it states, and what a check concludes from all."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calibration.check.assessment import assess_check
from calibration.check.floor_lines import FloorSegments, floor_segments, floor_tilt
from calibration.check.mounting import MountingCheck, NamedYaw
from calibration.check.pallet_heights import PalletElevations, height_estimate
from calibration.check.report import check_page
from calibration.check.tilt_sources import (
    FLOOR,
    LEVELS,
    PALLETS,
    VERTICALS,
    Absent,
    Contradiction,
    NamedTilt,
    fused_tilt,
)
from calibration.findings import DEGENERATE, FAIL, PASS
from calibration.result_page import json_text
from calibration.shelf.gravity_lines import Tilt
from calibration.shelf.line_segments import Segments
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import angles_from_transform, transform_from_angles
from palletloc.io.recording import RECORDING, read_recording
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import Calibrate, present

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


def tilt(roll: float, pitch: float, sigma: tuple[float, float]) -> Tilt:
    return Tilt(np.radians([roll, pitch]), np.diag(np.radians(sigma) ** -2.0), 20)


def test_of_three_sources_the_two_that_contradict_each_other_are_named() -> None:
    told = [
        NamedTilt(VERTICALS, tilt(0.0, 0.0, (0.03, 0.03))),
        NamedTilt(LEVELS, tilt(0.0, 0.1, (100.0, 0.15))),
        NamedTilt(PALLETS, tilt(0.1, 0.5, (0.2, 0.04))),
    ]
    fused = fused_tilt(told)
    assert fused.chance < 1e-3
    assert fused.worst is not None
    assert {fused.worst.first, fused.worst.second} == {VERTICALS, PALLETS}


def test_sources_that_agree_make_the_result_surer() -> None:
    told = [NamedTilt(VERTICALS, tilt(0.2, 0.1, (0.04, 0.04))), NamedTilt(FLOOR, tilt(0.25, 0.0, (0.1, 90.0)))]
    fused = fused_tilt(told)
    assert fused.chance > 0.3
    assert np.degrees(np.sqrt(fused.covariance[0, 0])) < 0.04
    assert 0.2 < np.degrees(fused.turn[0]) < 0.25


def test_sources_of_different_axes_cannot_contradict_each_other() -> None:
    told = [NamedTilt(LEVELS, tilt(0.0, 1.0, (90.0, 0.1))), NamedTilt(FLOOR, tilt(1.0, 0.0, (0.1, 90.0)))]
    assert fused_tilt(told).worst is None


CENTER = np.array([0.3, 0.1, 1.8])
FRONT = ShelfPlane(0.0, 2.2, -np.pi / 2)


def turned(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    return vectors + np.cross(np.array([*turn, 0.0]), vectors)


def floor(rng: np.random.Generator, turn: FloatArray, lines: list[tuple[float, float]]) -> FloorSegments:
    """Return lines of a floor, each a heading and the distance from odom's origin, seen along a way of two metres."""
    shots, poses = [], []
    for way in np.linspace(0.0, 2.0, 5):
        normals, middles = [], []
        for heading, place in lines:
            along = np.array([np.cos(heading), np.sin(heading), 0.0])
            foot = place * np.array([-along[1], along[0], 0.0]) - CENTER - [way, 0.0, 0.0]
            for reach in (-0.5, 0.8):
                point = foot + (reach - foot @ along) * along
                normal = np.cross(point, along)
                normal /= np.linalg.norm(normal)
                normals.append(turned(normal, turn) + 0.0005 * rng.standard_normal() * along)
                middles.append(turned(point / np.linalg.norm(point), turn))
        count = len(normals)
        shots.append(Segments(np.array(normals), np.array(middles), np.full(count, 0.2), np.full(count, 0.0005)))
        poses.append([way, 0.0, 0.0])
    return floor_segments(shots, np.array(poses), CENTER, FRONT)


def test_lines_on_the_floor_tell_the_turn_within_what_they_state() -> None:
    square = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        turn = np.radians(rng.uniform(-0.4, 0.4, 2))
        lines = [(0.0, -1.3), (0.0, 1.6), (np.pi / 2, 0.9), (np.pi / 2, -2.1)]
        built = [(heading + np.radians(0.2) * rng.standard_normal(), place) for heading, place in lines]
        tilt = present(floor_tilt(floor(rng, turn, built)))
        off = tilt.turn - turn
        square.append(float(off @ tilt.information @ off))
    assert np.mean(square) < 3.5  # two degrees of freedom, lines truer than assumed
    assert np.max(square) < 14


def test_lines_along_the_way_leave_the_turn_about_it_open() -> None:
    tilt = present(floor_tilt(floor(np.random.default_rng(1), np.radians([0.3, 0.3]), [(0.0, -1.4), (0.0, 1.5)])))
    values, axes = np.linalg.eigh(tilt.information)
    assert values[0] == pytest.approx(0.0, abs=1e-6 * values[1])
    assert abs(axes[1, 1]) == pytest.approx(1.0, abs=0.02)
    assert abs(tilt.turn[1] - np.radians(0.3)) < 3 / np.sqrt(values[1])


def test_marks_of_tyres_are_not_lines_that_count() -> None:
    assert floor_tilt(floor(np.random.default_rng(1), np.zeros(2), [(np.radians(6.0), 0.5)])) is None


def test_what_seems_to_lie_behind_the_front_is_no_floor() -> None:
    assert floor_tilt(floor(np.random.default_rng(1), np.zeros(2), [(0.0, 2.4), (0.0, 3.0)])) is None


def sights(rng: np.random.Generator, turn: FloatArray, higher: float, pallets: int = 4) -> PalletElevations:
    """Return pallets on both levels, as a camera sees them that is turned and higher than stated."""
    levels = np.array([0.0, 1.5])[np.arange(pallets) % 2]
    heights, off = levels + 0.006 * rng.standard_normal(pallets), 0.006 * rng.standard_normal(pallets)
    rows = []
    for way in np.linspace(0.0, 2.5, 10):
        for i in range(pallets):
            place = np.array([0.4 + 0.7 * i - way, 1.9, 0.0])
            ray = turned(np.array([*place[:2], heights[i] - CENTER[2] - higher]), turn)
            seen = float(np.arctan2(ray[2], np.hypot(*ray[:2]))) + 0.001 * rng.standard_normal()
            rows.append((i, np.arctan2(ray[1], ray[0]), float(np.hypot(*place[:2])) + off[i], seen, 0.001))
    pallet, azimuth, distance, elevation, sigma = np.array(rows).T
    return PalletElevations(pallet, azimuth, distance, elevation, sigma, levels, np.full(pallets, 0.006))


def test_pallets_tell_the_turn_and_the_height_within_what_they_state() -> None:
    square, pitch = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = np.array([*np.radians(rng.uniform(-1, 1, 2)), 0.02 * rng.standard_normal()])
        estimate = present(height_estimate(sights(rng, truth[:2], truth[2]), CENTER[2]))
        off = np.array([*estimate.tilt.turn, estimate.height]) - truth
        square.append(float(off @ np.linalg.solve(estimate.covariance, off)))
        pitch.append(float(np.degrees(np.sqrt(estimate.covariance[1, 1]))))
    assert 1.8 < np.mean(square) < 4.5  # three degrees of freedom
    assert max(pitch) < 0.1


def test_a_known_tilt_tells_the_height_better() -> None:
    truth = np.radians([0.4, -0.3])
    estimate = present(height_estimate(sights(np.random.default_rng(3), truth, 0.025), CENTER[2]))
    height, sigma = estimate.height_given(truth, np.diag(np.radians([0.02, 0.02])) ** 2)
    assert sigma < np.sqrt(estimate.covariance[2, 2])
    assert abs(height - 0.025) < 3 * sigma


def test_a_pallet_of_unknown_height_still_tells_the_pitch_but_not_the_height() -> None:
    known = sights(np.random.default_rng(5), np.radians([0.0, 0.5]), 0.0)
    estimate = present(height_estimate(replace(known, height_sigmas=np.full(4, 0.3)), CENTER[2]))
    sigma = np.sqrt(np.diag(estimate.covariance))
    assert abs(estimate.tilt.turn[1] - np.radians(0.5)) < 3 * sigma[1] < np.radians(0.5)
    assert sigma[2] > 0.015


def test_too_few_pallets_tell_nothing() -> None:
    alone = sights(np.random.default_rng(0), np.zeros(2), 0.0, pallets=1)
    rows = ("pallet", "azimuth", "distance", "elevation", "sigma")
    few = replace(alone, **{row: getattr(alone, row)[:5] for row in rows})
    assert height_estimate(few, CENTER[2]) is None
