"""What the method reaches on recordings with exact truth, and whether its covariances tell the truth."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from palletloc import LevelPose, Localizer, Start
from palletloc.evaluation.pose_error import PoseError, from_measurements, true_faces
from palletloc.evaluation.run_match import ShotMatch, match_shot
from palletloc.geometry import FloatArray
from palletloc.io.truth import read_truth
from palletloc.recording_run import read_job
from palletloc.synthetic.aisle import misshapen
from palletloc.synthetic.rig import disturbed
from tests.palletloc.poses import Models, Portrait

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
WELL_BELOW = 0.6

pytestmark = pytest.mark.skipif(not (DATA / "dev_lab").is_dir(), reason=f"no recordings in {DATA}")


@cache
def matched(name: str, step: int) -> tuple[ShotMatch, ...]:
    """Return the rows of every so many shots, each with its true pallet."""
    job = read_job(DATA / name)
    truth, mounting = read_truth(job.recording.folder), job.recording.forklift_from_camera
    widths, shots = {model.name: model.width for model in job.recording.models}, []
    for explanation in map(job.explain, range(0, len(job.shots), step)):
        time = explanation.shot.time
        faces = true_faces(truth.pallets, widths, truth.forklift.pose_at(time), mounting)
        shots.append(match_shot(time, from_measurements(explanation.measurements), faces))
    return tuple(shots)


def found_of(name: str, step: int, well_below: bool = True) -> tuple[list[PoseError], int]:
    """Return the errors of visible pallets, well below the camera or not, and how many of them there are in all."""
    shots = matched(name, step)
    errors = [error for shot in shots for error in shot.errors if (error.face.below >= WELL_BELOW) is well_below]
    missed = [face for shot in shots for face in shot.missed if (face.below >= WELL_BELOW) is well_below]
    return errors, len(errors) + len(missed)


def percentile(values: list[float], share: float) -> float:
    return float(np.percentile(np.abs(values), share))


FEW = [pytest.param(name, step, id=f"{name}-few") for name, step in (("dev_lab", 9), ("dev_warehouse", 5))]
ALL = [pytest.param(name, 1, id=f"{name}-all", marks=pytest.mark.slow) for name in ("dev_lab", "dev_warehouse")]
recordings = pytest.mark.parametrize(("name", "step"), [*FEW, *ALL])


@recordings
def test_pallets_well_below_the_camera_are_found_and_hardly_anything_else(name: str, step: int) -> None:
    errors, wanted = found_of(name, step)
    shots = matched(name, step)
    assert wanted >= 0.7 * len(shots)
    assert len(errors) >= 0.98 * wanted
    assert sum(len(shot.false) for shot in shots) <= 0.03 * len(shots)


@recordings
def test_yaw_depth_and_place_are_as_good_as_they_must_be_and_the_model_is_right(name: str, step: int) -> None:
    errors, _ = found_of(name, step)
    yaws = np.degrees([error.yaw for error in errors]).tolist()
    assert percentile(yaws, 50) < 0.10
    assert percentile(yaws, 95) < 0.5
    assert percentile([error.depth for error in errors], 95) < 0.015
    assert percentile([error.along for error in errors], 95) < 0.030
    assert all(error.estimate.model == error.face.model for error in errors)


@pytest.mark.parametrize(("name", "step"), ALL)
def test_covariances_are_consistent_and_pallets_at_the_cameras_height_are_found(name: str, step: int) -> None:
    errors, _ = found_of(name, step)
    assert 1.0 < np.mean([error.nees for error in errors]) < 10.0  # less than 4 is right: these mountings are exact
    errors, wanted = found_of(name, step, well_below=False)
    assert len(errors) >= 0.9 * wanted


# Errors over many pictures, with pallets and mountings that are a little off.

COUNT = 45
FLOOR, LEVEL, ABOVE = 0.0, 1.7, 2.9


def squared_errors(z: float, known: bool, portrait: Portrait, models: Models) -> tuple[FloatArray, FloatArray]:
    """Return the normalised estimation error squared of each measurement, and the errors themselves."""
    rng = np.random.default_rng(1)
    squared, errors = [], []
    for number in range(COUNT):
        model = models[number % len(models)]
        x, y = rng.uniform([-0.6, 1.7], [2.2, 2.4])
        pose = LevelPose(float(x), float(y), z, np.pi / 2 + 0.03 * float(rng.standard_normal()))
        shot = portrait(misshapen(model, 1.0, rng), pose, seed=number)
        recorded = disturbed(shot.mounting.forklift_from_camera, 0.001, 0.0003, rng)
        mounting = replace(shot.mounting, forklift_from_camera=recorded)
        start = LevelPose(*(pose.as_array() + rng.normal(0.0, [0.02, 0.02, 0.0, 0.02])).tolist())
        levels = (z,) if known else ()
        assumed = replace(shot, mounting=mounting)
        found = Localizer([model]).localize_from(assumed, [Start(model.name, start)], levels)[0]
        if found is not None:
            error = found.forklift_from_pallet.minus(pose)
            squared.append(float(error @ np.linalg.solve(found.covariance, error)))
            errors.append(error)
    return np.array(squared), np.array(errors)


@pytest.mark.slow
def test_on_the_floor_errors_are_as_large_as_the_covariances_say(portrait: Portrait, models: Models) -> None:
    squared, errors = squared_errors(FLOOR, True, portrait, models)
    assert len(squared) >= 40
    assert 0.7 < squared.mean() < 10.0
    assert 0.7 < np.median(squared) < 8.0
    assert np.percentile(np.abs(errors[:, :3]), 95) < 0.02
    assert np.percentile(np.abs(errors[:, 3]), 95) < np.radians(0.6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("z", "known", "measured", "off"),
    [(LEVEL, True, 0.4, 0.1), (ABOVE, True, 0.9, 0.1), (FLOOR, False, 0.9, 0.2), (ABOVE, False, 0.9, 0.2)],
)
def test_near_and_above_the_camera_and_without_a_known_height_most_errors_are_as_large_as_the_covariances_say(
    z: float, known: bool, measured: float, off: float, portrait: Portrait, models: Models
) -> None:
    squared, _ = squared_errors(z, known, portrait, models)
    assert len(squared) >= measured * COUNT  # level with the camera, many poses are too uncertain to be reported
    assert 0.7 < np.median(squared) < 10.0
    assert (
        np.mean(squared > 40.0) < off
    )  # of free height, every edge fits along the ray: some settle in a wrong place
