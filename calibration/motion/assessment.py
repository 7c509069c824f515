"""What a drive past targets tells about the stated mounting, and what it cannot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from calibration.degeneracy import LIMITS, in_words
from calibration.findings import PASS, Finding, Severity, exit_code, notes_on_input
from calibration.motion.fit import MotionFit, fit_motion
from calibration.motion.problem import MotionProblem
from calibration.motion.start import start_motion
from calibration.motion.task import MotionTask, read_motion_task
from calibration.mounting.assessment import MAX_POSITION_SIGMA, MAX_ROTATION_SIGMA
from calibration.targets.observations import TargetObservation, observe
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray
from palletloc.mounting import Mounting

_LEAST_SHOTS = 5
"""With fewer shots that show a target nothing is fitted."""
_CHANCE = 0.001
"""The drive contradicts the stated mounting where chance leaves such a difference to fewer cases."""
_SIGMAS, _DELAY, _SCALE = 4.0, 0.01, 0.005
"""A delay and a scale are told from so many standard deviations on, and from so many seconds and parts of one."""
_SLIP = 6.0
"""A step of the odometry that is off by more standard deviations is a slip of the wheels."""
_ARC = 2
"""Directions that a drive on one arc loses whatever the wheels' scale."""
_KINDS = {4: "a straight drive", 2: "a drive on one arc, or a turn on the spot", 1: "a drive on the floor"}
"""By the number of directions that motion alone loses."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionAssessment:
    """A drive with all that there is to say."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    fit: MotionFit | None = None
    """The numbers; None where there are too few."""
    away: FloatArray | None = None
    """(6,) found minus stated mounting, along and about the forklift's axes, in metres and radians."""

    @property
    def exit_code(self) -> int:
        """0 where all six numbers are known and agree, 1 where they disagree, 3 where some cannot be told."""
        return exit_code(self.findings)


@dataclass(frozen=True, slots=True, eq=False)
class MotionResult:
    """What a drive past targets tells about the mounting that its recording states."""

    assessment: MotionAssessment
    """The fit, and what was found about it."""
    camera: CameraModel
    """Of the recording."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What fails or restricts the result, in the order in which it was found."""
        return self.assessment.findings

    @property
    def mounting(self) -> Mounting | None:
        """The camera's pose on the forklift; None where a number is not known or contradicts the stated one."""
        fit = self.assessment.fit
        if fit is None or self.assessment.exit_code != PASS:
            return None
        x, y, z, roll, pitch, yaw = (float(value) for value in fit.sigma)
        return Mounting(fit.state.camera, (x, y, z), (roll, pitch, yaw))


def calibrate_motion(folder: Path, on_progress: Callable[[str], None] = lambda _: None) -> MotionResult:
    """Check the mounting that a recording states by a drive past targets, as far as such a drive can tell.

    Parameters
    ----------
    folder : Path
        The recording, with targets.yaml.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    MotionResult
        With the findings; `motion_page` shows it.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or a target is there twice.
    """
    task = read_motion_task(folder)
    notes = tuple(notes_on_input(task.recording.notes))
    observations = _observed(task, on_progress)
    on_progress("fitting")
    if not observations:
        how = "check the shots, the dictionary and the ids; a marker needs a side of about 20 px in the shot"
        fault = Finding(Severity.DEGENERATE, "no_target_seen", "no target is seen in any shot", how)
        return MotionResult(MotionAssessment((fault, *notes)), task.recording.camera)
    assessment = assess_motion(_problem(task, observations), task.recording.mounting.sigma)
    return MotionResult(replace(assessment, findings=(*assessment.findings, *notes)), task.recording.camera)


def _observed(task: MotionTask, on_progress: Callable[[str], None]) -> list[tuple[int, TargetObservation]]:
    """Return the targets in the shots that the odometry covers, each with the number of its shot."""
    recording = task.recording
    start, end = recording.odometry.span
    found = []
    for index, shot in enumerate(recording.shots):
        if start <= shot.time <= end:
            image = recording.image(shot, gray=True)
            seen = observe(recording.camera, image, shot.file, task.targets, on_progress)
            found += [(index, observation) for observation in seen]
    return found


def _problem(task: MotionTask, observations: Sequence[tuple[int, TargetObservation]]) -> MotionProblem:
    recording = task.recording
    seen = {observation.target for _, observation in observations}
    names = [name for name in task.targets if name in seen]
    shots = sorted({index for index, _ in observations})
    return MotionProblem(
        np.array([recording.shots[index].time for index in shots]),
        recording.odometry,
        task.noise,
        tuple(observation.numbered(names.index(observation.target)) for _, observation in observations),
        tuple(shots.index(index) for index, _ in observations),
        len(names),
        recording.forklift_from_camera,
        {names.index(name): height for name, height in task.heights.items() if name in names},
        scale_sigma=task.scale_sigma,
    )


def assess_motion(problem: MotionProblem, stated_sigma: FloatArray) -> MotionAssessment:
    """Fit and judge.

    Parameters
    ----------
    problem : MotionProblem
        The observations, of one target at least.
    stated_sigma : (6,) array
        Standard deviations of the stated mounting, in metres and radians.
    """
    how = f"drive so that {_LEAST_SHOTS} shots and more show a target, from 1 to 4 m"
    if len(set(problem.shot_of)) < _LEAST_SHOTS:
        what = f"only {len(set(problem.shot_of))} shots show a target, expected at least {_LEAST_SHOTS}"
        return MotionAssessment((Finding(Severity.DEGENERATE, "few_sights", what, how),))
    start = start_motion(problem)
    if start is None:
        what = "a target has a pose in no shot: too few of its corners are seen"
        return MotionAssessment((Finding(Severity.DEGENERATE, "no_pose", what, how),))
    fit = fit_motion(*start)
    moved = fit.state.camera.translation - problem.stated.translation
    turned = (fit.state.camera.rotation * problem.stated.rotation.inv()).as_rotvec()
    away = np.concatenate([moved, turned])
    findings = [*_lost(fit), *_difference(fit, away, stated_sigma), *_faults(fit)]
    return MotionAssessment(tuple(findings), fit, away)


def _lost(fit: MotionFit) -> list[Finding]:
    lost = fit.split()[1]
    if not lost.shape[1]:
        sigma = fit.sigma
        if sigma[:3].max() <= MAX_POSITION_SIGMA and sigma[3:].max() <= MAX_ROTATION_SIGMA:
            return []
        what = (
            f"the pose is known to {1000 * sigma[:3].max():.0f} mm and {np.degrees(sigma[3:].max()):.2f} degrees only"
        )
        how = "use it as a check; surveyed targets give millimetres"
        return [Finding(Severity.FAIL, "too_uncertain", what, how)]
    words = "; ".join(in_words(lost[:, i]) for i in range(lost.shape[1]))
    kind = _KINDS.get(fit.kernel.shape[1], "this drive")
    what = f"{kind} does not tell {lost.shape[1]} of 6 directions: {words}"
    by_wheels = lost.shape[1] > fit.kernel.shape[1] == _ARC
    if by_wheels:
        what += "; the distance to the arc's centre is lost with the wheels' scale, which nothing here tells"
    how = "use surveyed targets for these"
    if lost.shape[1] > 1:
        how = "drive bends to both sides, 30 degrees and more each, with the target in sight; or use surveyed targets"
        if by_wheels:
            how += "; odometry_sigma.wheel_scale in targets.yaml bounds the wheels' scale by their data sheet"
    elif fit.kernel.shape[1] == 1:
        how = "state height_m of a target in targets.yaml, or measure the camera's height"
    return [Finding(Severity.DEGENERATE, "motion_lost", what, how)]


def _difference(fit: MotionFit, away: FloatArray, stated_sigma: FloatArray) -> list[Finding]:
    """Return whether the known directions contradict the stated mounting."""
    known, _ = fit.split()
    if not known.shape[1]:
        return []
    scale = np.outer(LIMITS, LIMITS)
    covariance = known.T @ ((fit.covariance + np.diag(stated_sigma**2)) / scale) @ known
    off = known.T @ (away / LIMITS)
    distance = float(off @ np.linalg.solve(covariance, off))
    if chi2.sf(distance, len(off)) > _CHANCE:
        return []
    place, turn = np.linalg.norm(known @ off * LIMITS * ([1] * 3 + [0] * 3)), known @ off * LIMITS
    what = (
        f"the stated mounting is off by {1000 * place:.0f} mm and {np.degrees(np.linalg.norm(turn[3:])):.2f} degrees"
        f" in what the drive tells, {np.sqrt(distance):.0f} standard deviations"
    )
    return [Finding(Severity.FAIL, "mounting_differs", what, "calibrate the mounting again with surveyed targets")]


def _faults(fit: MotionFit) -> list[Finding]:
    findings, state = [], fit.state
    scale, _, delay = fit.fault_sigma
    if abs(state.delay) > max(_SIGMAS * delay, _DELAY):
        what = f"the odometry's clock is {1000 * state.delay:+.0f} ms ahead of the camera's, +- {1000 * delay:.0f} ms"
        findings.append(Finding(Severity.WARNING, "time_offset", what, "correct time_s in shots.csv by it"))
    if abs(state.scale - 1) > max(_SIGMAS * scale, _SCALE):
        what = f"true distances are {state.scale:.4f} +- {scale:.4f} times the odometry's"
        findings.append(Finding(Severity.WARNING, "wheel_scale", what, "correct the wheels' radius by it"))
    slips = np.abs(fit.problem.slips(state)).max(1) * fit.problem.drive_scale
    worst = int(np.argmax(slips))
    if slips[worst] > _SLIP:
        what = (
            f"the odometry jumps by {slips[worst]:.0f} sigma before the shot at {fit.problem.times[worst + 1]:.2f} s"
        )
        findings.append(Finding(Severity.WARNING, "slip", what, "drive slower, on a dry floor"))
    if fit.problem.drive_scale > 2:
        what = f"the odometry's errors are {fit.problem.drive_scale:.1f} times as large as assumed"
        findings.append(Finding(Severity.WARNING, "odometry_sigma", what, "state odometry_sigma in targets.yaml"))
    return findings
