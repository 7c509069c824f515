"""What the method reaches on recordings with exact truth, and whether its covariances tell the truth."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from palletloc import LevelPose, Localizer, PalletMeasurement, Recording, Start
from palletloc.geometry import FloatArray, level_pose
from palletloc.recording_run import Job, read_job
from palletloc.synthetic.aisle import misshapen
from palletloc.synthetic.rig import disturbed
from tests.palletloc.poses import Models, Portrait

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
MAX_RANGE = 4.5
WELL_BELOW = 0.6
NEAREST_BEARING, FARTHEST_BEARING = np.radians([6.0, 116.0])
MATCHED = 0.5

pytestmark = pytest.mark.skipif(not (DATA / "dev_lab").is_dir(), reason=f"no recordings in {DATA}")


@dataclass(frozen=True, slots=True)
class TruePallet:
    """A pallet that stands there at a shot's time."""

    pose: LevelPose
    """``forklift_from_pallet``."""
    model: str
    """Its model."""
    visible: bool
    """Whether its whole front lies within range and bearing."""
    below: float
    """How far it is below the camera, in metres."""


@dataclass(frozen=True, slots=True)
class Hit:
    """A visible pallet and its row, if there is one."""

    truth: TruePallet
    """The pallet."""
    row: PalletMeasurement | None
    """What was measured."""

    @property
    def error(self) -> FloatArray:
        """x, y, z, yaw against the truth."""
        if self.row is None:
            raise ValueError("a pallet that was not found has no error")
        return self.row.forklift_from_pallet.minus(self.truth.pose)


@dataclass(frozen=True, slots=True)
class Comparison:
    """What was found in some shots."""

    shots: int
    """How many."""
    hits: tuple[Hit, ...]
    """Of all visible pallets."""
    false: int
    """Rows where no pallet stands."""

    def found(self, well_below: bool) -> list[Hit]:
        """Return the pallets that were found, well below the camera or not."""
        return [hit for hit in self.wanted(well_below) if hit.row is not None]

    def wanted(self, well_below: bool) -> list[Hit]:
        """Return the visible pallets, well below the camera or not."""
        return [hit for hit in self.hits if (hit.truth.below >= WELL_BELOW) is well_below]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def pose_of(row: dict[str, str]) -> LevelPose:
    return LevelPose(*(float(row[key]) for key in ("x_m", "y_m", "z_m", "yaw_rad")))


def true_pallets(recording: Recording, time: float) -> Iterator[TruePallet]:
    widths = {model.name: model.width for model in recording.models}
    forklifts = rows(recording.folder / "truth" / "forklift.csv")
    world_from_forklift = pose_of(min(forklifts, key=lambda row: abs(float(row["time_s"]) - time))).transform()
    camera_from_forklift = recording.forklift_from_camera.inv()
    for row in rows(recording.folder / "truth" / "pallets.csv"):
        pose = level_pose(world_from_forklift.inv() * pose_of(row).transform())
        half = widths[row["model"]] / 2
        front = pose.transform().apply([[0.0, 0.0, 0.0], [0.0, half, 0.0], [0.0, -half, 0.0]])
        seen = camera_from_forklift.apply(front)
        bearing = np.arctan2(seen[:, 1], seen[:, 0])
        bearing *= np.sign(bearing[0])
        ahead = bearing.min() > NEAREST_BEARING and bearing.max() < FARTHEST_BEARING
        near = np.linalg.norm(seen[0]) <= MAX_RANGE
        below = float(recording.forklift_from_camera.translation[2]) - pose.z
        yield TruePallet(pose, row["model"], bool(ahead and near), below)


def compared(job: Job, numbers: tuple[int, ...]) -> Comparison:
    hits: list[Hit] = []
    false = 0
    for number in numbers:
        explanation = job.explain(number)
        left = list(explanation.measurements)
        for truth in true_pallets(job.recording, explanation.shot.time):

            def away(row: PalletMeasurement, truth: TruePallet = truth) -> float:
                return float(np.linalg.norm((row.forklift_from_pallet.as_array() - truth.pose.as_array())[:3]))

            row = min(left, key=away, default=None)
            if row is not None and away(row) < MATCHED:
                left.remove(row)
            else:
                row = None
            if truth.visible:
                hits.append(Hit(truth, row))
        false += len(left)
    return Comparison(len(numbers), tuple(hits), false)


@cache
def outcome(name: str, step: int) -> Comparison:
    job = read_job(DATA / name)
    return compared(job, tuple(range(0, len(job.shots), step)))


def percentile(values: FloatArray, share: float) -> float:
    return float(np.percentile(np.abs(values), share))


def in_face(hits: list[Hit]) -> tuple[FloatArray, FloatArray]:
    """Errors across and along the pallets' fronts."""
    errors = np.array([hit.error for hit in hits])
    yaws = np.array([hit.truth.pose.yaw for hit in hits])
    into, left = (np.stack([np.cos(turn), np.sin(turn)], -1) for turn in (yaws, yaws + np.pi / 2))
    return (errors[:, :2] * into).sum(axis=1), (errors[:, :2] * left).sum(axis=1)


FEW = [pytest.param(name, step, id=f"{name}-few") for name, step in (("dev_lab", 9), ("dev_warehouse", 5))]
ALL = [pytest.param(name, 1, id=f"{name}-all", marks=pytest.mark.slow) for name in ("dev_lab", "dev_warehouse")]
recordings = pytest.mark.parametrize(("name", "step"), [*FEW, *ALL])


@recordings
def test_pallets_well_below_the_camera_are_found(name: str, step: int) -> None:
    result = outcome(name, step)
    wanted = result.wanted(well_below=True)
    assert len(wanted) >= 0.7 * result.shots
    assert len(result.found(well_below=True)) >= 0.98 * len(wanted)


@recordings
def test_there_are_hardly_any_false_rows(name: str, step: int) -> None:
    result = outcome(name, step)
    assert result.false <= 0.03 * result.shots


@recordings
def test_yaw_depth_and_place_are_as_good_as_they_must_be(name: str, step: int) -> None:
    found = outcome(name, step).found(well_below=True)
    yaw = np.degrees([hit.error[3] for hit in found])
    depth, along = in_face(found)
    assert percentile(yaw, 50) < 0.10
    assert percentile(yaw, 95) < 0.5
    assert percentile(depth, 95) < 0.015
    assert percentile(along, 95) < 0.030


@recordings
def test_the_model_is_the_right_one(name: str, step: int) -> None:
    found = outcome(name, step).found(well_below=True)
    assert all(hit.row is not None and hit.row.model == hit.truth.model for hit in found)


@pytest.mark.parametrize(("name", "step"), ALL)
def test_covariances_are_consistent(name: str, step: int) -> None:
    found = outcome(name, step).found(well_below=True)
    squared = [hit.error @ np.linalg.solve(hit.row.covariance, hit.error) for hit in found if hit.row is not None]
    assert 1.0 < np.mean(squared) < 10.0  # less than 4 is right: these mountings are exact


@pytest.mark.parametrize(("name", "step"), ALL)
def test_pallets_at_the_cameras_height_and_above_are_found(name: str, step: int) -> None:
    result = outcome(name, step)
    wanted = result.wanted(well_below=False)
    assert len(result.found(well_below=False)) >= 0.9 * len(wanted)


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
