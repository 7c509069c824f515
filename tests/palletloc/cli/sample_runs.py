"""Runs over the sample with known errors, surveys of it, and the command that evaluates them, for tests."""

import csv
import json
import shutil
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from palletloc.cli.app import run
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.tracks import TrackRow, write_tracks
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.track_status import Status

SAMPLE = Path(str(files("palletloc") / "sample"))
"""The recording that comes along."""
SIGMA = 0.005
"""Standard deviation that every run states, in metres and radians."""
SITE = LevelPose(410.0, 187.0, 11.6, 0.62)
"""``site_from_world``: the frame of surveys."""
_LIFT = {"V1": [-0.9, 0.45, 2.1], "V2": [-0.9, -0.45, 2.08], "V3": [0.55, -0.4, 1.2]}
"""Places of the forklift's targets on it, in metres."""
_FACE = {"LL": [0.0, 0.55, 0.012], "LR": [0.0, -0.55, 0.012], "UL": [0.0, 0.55, 0.132]}
"""Places of a pallet's targets on it, in metres."""


def without_images(folder: Path) -> Path:
    """Write a copy of the sample without its images."""
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("images"))
    return folder


def true_poses(folder: Path, time: float) -> dict[str, LevelPose]:
    """Return ``forklift_from_pallet`` of each pallet of a recording."""
    truth = read_truth(folder)
    forklift_from_world = truth.forklift.pose_at(time).transform().inv()
    poses = {pallet.id: forklift_from_world * pallet.world_from_pallet.transform() for pallet in truth.pallets}
    return {name: level_pose(pose) for name, pose in poses.items()}


def write_run(folder: Path, depth: float = 0.003, yaw: float = 0.002, false: bool = False) -> Path:
    """Write a run that finds every pallet of the sample in every shot, each too deep and turned by the same amounts.

    ``false`` adds an estimate to each shot where no pallet stands.
    """
    models, rows = [pallet.model for pallet in read_truth(SAMPLE).pallets], []
    off = LevelPose(depth, 0.0, 0.0, yaw).transform()
    for shot in read_recording(SAMPLE).shots:
        poses = [level_pose(pose.transform() * off) for pose in true_poses(SAMPLE, shot.time).values()]
        poses += [LevelPose(9.0, 9.0, 0.0, 0.0)] * false
        rows += [
            PalletMeasurement(shot.time, model, pose, SIGMA**2 * np.eye(4), 0.9, YawSource.FACE, shot.file)
            for model, pose in zip([*models, models[0]], poses, strict=False)
        ]
    folder.mkdir(parents=True)
    write_measurements(folder / "measurements.csv", rows)
    return folder


def with_tracks(folder: Path) -> Path:
    """Add tracks of the same poses to a run, the first one tentative."""
    with (folder / "measurements.csv").open() as file:
        cells = list(csv.DictReader(file))
    rows = []
    for number, row in enumerate(cells):
        pose = LevelPose(*(float(row[name]) for name in ("x_m", "y_m", "z_m", "yaw_rad")))
        status = Status.TENTATIVE if number == 0 else Status.CONFIRMED
        rows.append(TrackRow(float(row["time_s"]), 1, row["model"], status, pose, SIGMA**2 * np.eye(4), 0.0, 3))
    write_tracks(folder / "tracks.csv", rows)
    return folder


def write_survey(recording: Path, stops: Mapping[str, float], shift: float = 0.0) -> None:
    """Add an exact survey of the sample at the times of some stops; ``shift`` moves the forklift only, in metres."""
    truth, site = read_truth(SAMPLE), SITE.transform()
    points: dict[str, FloatArray] = {}
    for name, time in stops.items():
        pose = truth.forklift.pose_at(time)
        body = site * LevelPose(pose.x + shift, pose.y, pose.z, pose.yaw).transform()
        points |= {f"{target}-{name}": body.apply(place) for target, place in _LIFT.items()}
    bodies: dict[str, dict[str, list[float]]] = {"forklift": _LIFT}
    for pallet in truth.pallets:
        bodies[pallet.id] = {f"{pallet.id}-{target}": place for target, place in _FACE.items()}
        body = site * pallet.world_from_pallet.transform()
        points |= {name: body.apply(place) for name, place in bodies[pallet.id].items()}
    lines = [f"{name},{x:.6f},{y:.6f},{z:.6f}" for name, (x, y, z) in points.items()]
    (recording / "truth" / "survey.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]) + "\n")
    named = [{"name": name, "time_s": time} for name, time in stops.items()]
    plan = {"file": "survey.csv", "sigma_m": 0.0006, "stops": named, "bodies": bodies}
    (recording / "truth" / "survey.yaml").write_text(yaml.safe_dump(plan))


def evaluate(recording: Path, out: Path, *options: str | Path) -> int:
    """Run ``palletloc evaluate`` over a recording and return its exit code."""
    return run(["evaluate", str(recording), "--out", str(out), *map(str, options)])


def estimates(*folders: Path) -> list[str | Path]:
    """Return the options that name the runs to evaluate."""
    return [part for folder in folders for part in ("--estimate", folder)]


def read_metrics(out: Path) -> Any:
    """Return the content of metrics.json."""
    return json.loads((out / "metrics.json").read_text(encoding="utf-8"))
