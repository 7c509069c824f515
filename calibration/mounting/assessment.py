"""From observations to a verdict: which checks are made in which order, and what each of them says."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calibration.degeneracy import unobserved, weakest
from calibration.findings import PASS, Finding, Severity, exit_code
from calibration.mounting.checks import LeftOut, axis_fault, layout_fault, leave_each_out, size_faults, survey_test
from calibration.mounting.consensus import Reading, SurveyConsensus, agree
from calibration.mounting.fit import MountingFit, extra_parameter, fit_mounting, refit
from calibration.mounting.forklift_frame import ForkliftFrame
from calibration.mounting.problem import MountingProblem, Poses, SurveyedTarget
from calibration.mounting.task import MountingTask, read_mounting_task
from calibration.mounting.two_centres import (
    LEAST_DISTANCE,
    TwoCentres,
    apart,
    fit_two_centres,
    lens_distance,
    lens_finding,
)
from calibration.targets.board_detection import misprint
from calibration.targets.observations import CornerObservation, TargetObservation, observe
from calibration.targets.targets import SingleTag
from palletloc.cameras.protocol import CameraModel
from palletloc.io.camera_spec import is_panorama
from palletloc.io.images import read_image
from palletloc.io.schema import CameraSpec
from palletloc.mounting import Mounting

MAX_POSITION_SIGMA = 0.005
"""A larger standard deviation of the camera's place fails, in metres."""
MAX_ROTATION_SIGMA = float(np.radians(0.1))
"""A larger standard deviation of its rotation fails, in radians: 3.5 mm at a pallet 2 m away."""
_CHANCE = 0.001
"""A contradiction that is less probable than this by chance is believed: one false alarm in a thousand yards."""
_MAX_SURVEY_FACTOR = 3.0
"""A survey whose errors are more times as large as stated fails: below that, scaled sigmas still describe it."""
_MAX_SHIFT = 3.0
"""The pose leans on a target without which it moves by more standard deviations."""
_SCALE_SIGMAS = 4.0
"""A scale of the survey counts from so many standard deviations on: wide, for it fails the calibration."""
_LEAST_SCALE = 0.001
"""Smaller errors of the scale do no harm: 2 mm at 2 m."""
_LENSES_EXPLAIN = 0.15
"""Two lens centres are tried as an explanation where targets are off by less than this, in metres: they are some
centimetres apart, and what is farther off was moved."""
_MAX_RESIDUAL = float(np.radians(0.05))
"""Corners that scatter more point to the camera model or the stitching, in radians: half a pixel at 3840 around."""


@dataclass(frozen=True, slots=True, eq=False)
class MountingAssessment:
    """A calibration with all that was checked."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    consensus: SurveyConsensus | None = None
    """Where the fit began."""
    solution: MountingFit | None = None
    """The result; not to be used where the exit code is not 0."""
    left_out: tuple[LeftOut, ...] = ()
    """Each target left out."""
    centres: TwoCentres | None = None
    """Whether the camera has one centre."""
    scale: tuple[float, float] = (0.0, np.inf)
    """How much too large the survey is against the image, less one, with its standard deviation."""

    @property
    def exit_code(self) -> int:
        """0 where the result holds, 1 where it fails, 3 where the data cannot give one."""
        return exit_code(self.findings)


@dataclass(frozen=True, slots=True, eq=False)
class MountingResult:
    """The mounting that surveyed targets give."""

    assessment: MountingAssessment
    """The fit, and what was found about it."""
    camera: CameraSpec
    """The camera, as files have it."""
    observations: tuple[TargetObservation, ...] = ()
    """Targets in shots."""
    names: tuple[str, ...] = ()
    """Of the targets that are seen, in the fit's order."""
    unseen: tuple[str, ...] = ()
    """Targets that no shot shows."""
    misprints: Mapping[str, str] = field(default_factory=dict)
    """What is wrong with the print of some of them."""
    frame: ForkliftFrame | None = None
    """Where the forklift stood in the survey; None where the corners were given in its frame."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What fails or restricts the result, in the order in which it was found."""
        return self.assessment.findings

    @property
    def mounting(self) -> Mounting | None:
        """The camera's pose on the forklift with its standard deviations; None where the calibration fails."""
        solution = self.assessment.solution
        return None if solution is None or self.assessment.exit_code != PASS else solution.mounting


def calibrate_mounting(
    folder: Path, on_progress: Callable[[str], None] = lambda _: None, columns: Sequence[str] | None = None
) -> MountingResult:
    """Find the camera's pose on the forklift from surveyed targets.

    Parameters
    ----------
    folder : Path
        With extrinsics.yaml and its shots.
    on_progress : callable
        Is told what is done next.
    columns : sequence of str, optional
        What the columns of a surveyed table are, from the left; in place of what extrinsics.yaml says.

    Returns
    -------
    MountingResult
        With the findings; `mounting_page` shows it.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or a target is there twice.
    """
    task = read_mounting_task(folder, columns)
    if task.frame is not None and task.frame.pose is None:
        return MountingResult(MountingAssessment(task.frame.findings), task.camera_spec, frame=task.frame)
    size = (task.camera.width, task.camera.height)
    observations: list[TargetObservation] = []
    for shot in task.shots:
        image = read_image(task.folder / shot, size, gray=True, panorama=is_panorama(task.camera))
        observations += observe(task.camera, image, shot, task.targets, on_progress)
    seen = {observation.target for observation in observations}
    names = tuple(name for name in task.targets if name in seen)
    on_progress("fitting")
    assessment = assess_mounting(_observed_problem(task, observations, names), task.camera, task.frame)
    unseen = tuple(name for name in task.targets if name not in seen)
    misprints = _misprints(task, unseen, size)
    return MountingResult(assessment, task.camera_spec, tuple(observations), names, unseen, misprints, task.frame)


def _misprints(task: MountingTask, unseen: Sequence[str], size: tuple[int, int]) -> dict[str, str]:
    """Return what is wrong with the print of targets that are not seen, as far as the first shot tells."""
    boards = [name for name in unseen if not isinstance(task.targets[name], SingleTag)]
    if not boards:
        return {}
    image = read_image(task.folder / task.shots[0], size, gray=True, panorama=is_panorama(task.camera))
    found = {name: misprint(task.camera, image, task.targets[name]) for name in boards}
    return {name: why for name, why in found.items() if why}


def _observed_problem(
    task: MountingTask, observations: Sequence[TargetObservation], names: Sequence[str]
) -> MountingProblem:
    """Return the equations for what was observed of the named targets."""
    corners = tuple(observation.numbered(names.index(observation.target)) for observation in observations)
    return MountingProblem(tuple(task.surveys[name] for name in names), corners, (True,) * len(names))


def assess_mounting(
    problem: MountingProblem, camera: CameraModel, frame: ForkliftFrame | None = None
) -> MountingAssessment:
    """Calibrate and check.

    Parameters
    ----------
    problem : MountingProblem
        The observations of the targets that are seen.
    camera : CameraModel
        Of the shots.
    frame : ForkliftFrame, optional
        Where the forklift stood in the survey; its errors add to the result's.

    Returns
    -------
    MountingAssessment
        Without a solution where the data cannot give one.
    """
    faults = [*(() if frame is None else frame.findings), *size_faults(problem.surveys)]
    fault = layout_fault(problem.surveys, problem.observations)
    if fault is not None or any(finding.code == "units" for finding in faults):
        return MountingAssessment((*faults, *([fault] if fault else [])))
    consensus = agree(problem)
    if consensus is None:
        how = "check that the targets are seen whole and near enough"
        finding = Finding(Severity.DEGENERATE, "no_pose", "no target alone has a pose in the image", how)
        return MountingAssessment((*faults, finding))
    if not all(consensus.agrees) or any(reading is not Reading.AS_NAMED for reading in consensus.readings):
        axes = axis_fault(problem)
        if axes is not None:
            return MountingAssessment((*faults, axes), consensus)
    findings = [*faults, *_reading_findings(consensus)]
    trusted, moved = _without_moved(consensus)
    findings += moved
    near = float(consensus.misfit.max()) < _LENSES_EXPLAIN
    lenses = _two_lenses(consensus.problem, consensus.poses, camera) if moved and near else None
    if lenses is not None:
        return MountingAssessment((*findings[: -len(moved)], lenses), consensus)
    fault = layout_fault(*_counted(trusted)) if moved else None
    if fault is not None:
        return MountingAssessment((*findings, fault), consensus)
    return _assess_solution(trusted, consensus, camera, frame, findings)


def _assess_solution(
    problem: MountingProblem,
    consensus: SurveyConsensus,
    camera: CameraModel,
    frame: ForkliftFrame | None,
    findings: list[Finding],
) -> MountingAssessment:
    try:
        solution = fit_mounting(problem, consensus.poses)
    except np.linalg.LinAlgError:
        fault = unobserved(np.full((6, 6), np.inf))
        return MountingAssessment((*findings, *([fault] if fault else [])), consensus)
    fault = unobserved(solution.covariance)
    if fault is not None:
        return MountingAssessment((*findings, fault), consensus, solution)
    left_out = leave_each_out(solution) if sum(problem.surveyed) > 1 else ()
    left_out = tuple(left for left, counts in zip(left_out, problem.surveyed, strict=True) if counts)
    centres = lens_distance(solution, camera)
    value, sigma = extra_parameter(solution, solution.problem.by_survey_scale())
    scale = (-value, sigma)  # the factor that the survey needs is the inverse of how much too large it is
    lenses = None
    if survey_test(_as_stated(solution)) < _CHANCE:
        lenses = _two_lenses(problem, consensus.poses, camera)
    if lenses is not None:
        findings.append(lenses)
    else:
        findings += _scale_findings(scale) or _contradictions(solution, left_out, centres)
    if frame is not None:
        solution = solution.with_frame_errors(frame.camera_covariance(solution.poses.camera))
    findings += _limits(solution, left_out)
    return MountingAssessment(tuple(findings), consensus, solution, left_out, centres, scale)


def _as_stated(solution: MountingFit) -> MountingFit:
    """Return the solution with the survey's standard deviations as stated."""
    return refit(solution, replace(solution.problem, survey_scale=1.0))


def _two_lenses(problem: MountingProblem, start: Poses, camera: CameraModel) -> Finding | None:
    """Return the finding that two lens centres explain what one does not, or None."""
    if camera.period_px is None:
        return None
    solution, distance = fit_two_centres(problem, start)
    explained = abs(distance) > LEAST_DISTANCE and survey_test(_as_stated(solution)) > _CHANCE
    return apart(distance) if explained else None


def _counted(problem: MountingProblem) -> tuple[list[SurveyedTarget], list[CornerObservation]]:
    surveys = [survey for survey, counts in zip(problem.surveys, problem.surveyed, strict=True) if counts]
    return surveys, [corners for corners in problem.observations if problem.surveyed[corners.target]]


def _reading_findings(consensus: SurveyConsensus) -> list[Finding]:
    """Return for which targets the corners are named otherwise than the pattern stands."""
    findings = []
    for survey, reading in zip(consensus.problem.surveys, consensus.readings, strict=True):
        what = f"target {survey.name}: the surveyed corners fit when they are read as {reading.replace('_', ' ')}"
        if reading is Reading.UPSIDE_DOWN:
            how = "nothing; the board hangs upside down, or its corners are named from below"
            findings.append(Finding(Severity.NOTE, "upside_down", f"{what}; they were read so", how))
        elif reading is not Reading.AS_NAMED:
            how = "name the corners as they are seen from the front of the pattern"
            findings.append(Finding(Severity.FAIL, "corners_swapped", what, how))
    return findings


def _without_moved(consensus: SurveyConsensus) -> tuple[MountingProblem, list[Finding]]:
    """Return the problem in which targets that are centimetres off no longer count, and name them."""
    problem, findings = consensus.problem, list[Finding]()
    for k, (survey, agrees) in enumerate(zip(problem.surveys, consensus.agrees, strict=True)):
        if not agrees:
            findings.append(_moved(survey.name, float(consensus.misfit[k])))
            problem = problem.without_survey(k)
    return problem, findings


def _moved(name: str, distance: float) -> Finding:
    what = f"target {name} is {1000 * distance:.1f} mm away from where it was surveyed; the others agree without it"
    how = f"survey {name} again, check that its ids and its name belong together, or leave it out"
    return Finding(Severity.FAIL, "target_moved", what, how)


def _contradictions(solution: MountingFit, left_out: Sequence[LeftOut], centres: TwoCentres | None) -> list[Finding]:
    """Return what contradicts what: one target the others, the lenses one centre, or the survey its sigma."""
    lens = None if centres is None else lens_finding(centres)
    suspects = [left for left in left_out if left.probability < _CHANCE / len(left_out)]
    if survey_test(_as_stated(solution)) > _CHANCE:
        found = [_moved(suspect.target, suspect.distance) for suspect in suspects[:1]]
        return found + ([lens] if lens is not None else [])
    if suspects:
        guilty = max(suspects, key=lambda suspect: suspect.rest_probability)
        if guilty.rest_probability > _CHANCE:
            restricts = [] if lens is None or lens.severity is Severity.FAIL else [lens]
            return [_moved(guilty.target, guilty.distance), *restricts]
    what = f"the survey's errors are {solution.survey_factor:.1f} times as large as sigma_m says"
    bad = solution.survey_factor > _MAX_SURVEY_FACTOR
    how = "survey the targets again" if bad else "state a larger sigma_m; the result's sigmas allow for it already"
    finding = Finding(Severity.FAIL if bad else Severity.WARNING, "survey_sigma", what, how)
    return [finding] + ([lens] if lens is not None else [])


def _scale_findings(scale: tuple[float, float]) -> list[Finding]:
    value, sigma = scale
    if abs(value) < max(_SCALE_SIGMAS * sigma, _LEAST_SCALE):
        return []
    what = f"the survey is {100 * value:+.2f} % larger than the image and the printed size say"
    how = "check the printed size with a ruler, and the scale of the survey"
    return [Finding(Severity.FAIL, "scale", what, how)]


def _limits(solution: MountingFit, left_out: Sequence[LeftOut]) -> list[Finding]:
    """Return what is too uncertain, leans on one target, or does not fit the camera model."""
    findings, sigma = [], solution.sigma
    if sigma[:3].max() > MAX_POSITION_SIGMA or sigma[3:].max() > MAX_ROTATION_SIGMA:
        what = (
            f"the pose is known to {1000 * sigma[:3].max():.1f} mm and {np.degrees(sigma[3:].max()):.2f} degrees"
            f" only; the weakest direction is {weakest(solution.covariance)[1]}"
        )
        how = "hang more or larger targets, nearer and on more sides, or survey them more exactly"
        findings.append(Finding(Severity.FAIL, "too_uncertain", what, how))
    leaning = [left for left in left_out if np.abs(left.shift_in_rest_sigma).max() > _MAX_SHIFT]
    for left in leaning if len(left_out) > 2 else ():
        what = f"without target {left.target} the pose moves by {np.abs(left.shift_in_rest_sigma).max():.1f} sigma"
        findings.append(
            Finding(Severity.WARNING, "leans_on_target", what, f"survey {left.target} again, or hang another near it")
        )
    if len(left_out) < 3:
        what = "with two targets a fault in one of them cannot be told from one in the other"
        findings.append(Finding(Severity.WARNING, "no_hold_out", what, "hang a third target"))
    stated = np.concatenate([corners.sigma for corners in solution.problem.observations])
    if solution.bearing_factor * float(np.median(stated)) > _MAX_RESIDUAL:
        what = f"corners scatter by {np.degrees(solution.bearing_factor * np.median(stated)):.3f} degrees"
        how = "check the camera model; for stitched shots use static or saved stitching, not dynamic"
        findings.append(Finding(Severity.WARNING, "camera_model", what, how))
    return findings
