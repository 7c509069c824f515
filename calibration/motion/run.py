"""The command ``palletloc calibrate extrinsics --motion`` from recording to verdict."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table

from calibration.finding_table import finding_line
from calibration.findings import PASS, Finding, Severity
from calibration.motion.assessment import MotionAssessment, assess_motion
from calibration.motion.file import MotionTargets, read_motion_targets
from calibration.motion.network import MotionNetwork
from calibration.motion.report import fault_rows, motion_data, motion_page, motion_rows
from calibration.network import Sight
from calibration.observations import TargetObservation, observe
from calibration.outcome import Outcome, free_stem
from calibration.rig_file import rig_text
from calibration.texture_alignment import on_board
from palletloc.io.atomic import write_text
from palletloc.io.camera_spec import spec_from_camera
from palletloc.io.recording import Recording, read_recording
from palletloc.mounting import Mounting


def calibrate_motion(folder: Path, out: Path, on_progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Check the mounting of a recording that passes targets, as far as a drive on the floor can tell.

    Parameters
    ----------
    folder : Path
        The recording, with targets.yaml.
    out : Path
        The file rig.yaml, written only where all six numbers are known; the reports get its name with other endings.
    on_progress : callable
        Is told what is done next.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or cannot be written.
    """
    recording, targets = read_recording(folder), read_motion_targets(folder)
    observations = _observe(recording, targets, on_progress)
    on_progress("fitting")
    assessment = _assess(recording, targets, observations)
    passed = assessment.exit_code == PASS
    stem = out.with_suffix("") if passed else free_stem(out)
    files = [stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")]
    write_text(files[0], motion_page(assessment))
    write_text(files[1], json.dumps(motion_data(assessment), indent=1, allow_nan=False) + "\n")
    if passed and assessment.fit is not None:
        x, y, z, roll, pitch, yaw = (float(value) for value in assessment.fit.sigma)
        mounting = Mounting(assessment.fit.state.camera, (x, y, z), (roll, pitch, yaw))
        write_text(out, rig_text(spec_from_camera(recording.camera), mounting))
        files.insert(0, out)
    reasons = tuple(finding_line(one) for one in assessment.findings)
    return Outcome(assessment.exit_code, tuple(_summary(assessment)), tuple(files), reasons)


def _observe(
    recording: Recording, targets: MotionTargets, on_progress: Callable[[str], None]
) -> list[tuple[int, TargetObservation]]:
    start, end = recording.odometry.span
    found = []
    for index, shot in enumerate(recording.shots):
        if start <= shot.time <= end:
            image = recording.image(shot, gray=True)
            seen = observe(recording.camera, image, shot.file, targets.targets, on_progress)
            found += [(index, one) for one in seen]
    return found


def _assess(
    recording: Recording, targets: MotionTargets, observations: list[tuple[int, TargetObservation]]
) -> MotionAssessment:
    if not observations:
        how = "check the shots, the dictionary and the ids; a marker needs a side of about 20 px in the shot"
        return MotionAssessment(
            (Finding(Severity.DEGENERATE, "no_target_seen", "no target is seen in any shot", how),)
        )
    names = [name for name in targets.targets if any(one.target == name for _, one in observations)]
    shots = sorted({index for index, _ in observations})
    sights = tuple(
        Sight(
            names.index(one.target),
            on_board(one.corners.points),
            one.corners.bearings,
            one.corners.origins,
            one.corners.sigma,
        )
        for _, one in observations
    )
    network = MotionNetwork(
        np.array([recording.shots[index].time for index in shots]),
        recording.odometry,
        targets.noise,
        sights,
        tuple(shots.index(index) for index, _ in observations),
        len(names),
        recording.forklift_from_camera,
        {names.index(name): height for name, height in targets.heights.items() if name in names},
        scale_sigma=targets.scale_sigma,
    )
    return assess_motion(network, recording.mounting.sigma)


def _summary(assessment: MotionAssessment) -> list[RenderableType]:
    if assessment.fit is None:
        return []
    tables = []
    for heads, rows in (
        (("", "found minus stated", "sigma"), motion_rows(assessment)),
        (("odometry", "value", "sigma"), fault_rows(assessment)),
    ):
        table = Table(box=box.SIMPLE_HEAD)
        for name in heads:
            table.add_column(name, justify="right")
        for row in rows:
            table.add_row(*row)
        tables.append(table)
    return list(tables)
