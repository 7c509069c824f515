"""From observations to a verdict: which checks are made in which order, and what each of them says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.consensus import Consensus, Reading, agree
from calibration.degeneracy import layout_fault, unobserved, weakest
from calibration.extrinsics import Extrinsics, extra_parameter, resolve, solve
from calibration.findings import Finding, Severity, exit_code
from calibration.forklift_frame import ForkliftFrame
from calibration.leave_one_out import LeftOut, leave_each_out, survey_test
from calibration.network import Network, Poses, Sight, Survey
from calibration.survey_checks import axis_fault, size_faults
from calibration.two_centres import (
    LEAST_DISTANCE,
    TwoCentres,
    apart,
    fit_two_centres,
    lens_distance,
    lens_finding,
)
from palletloc.cameras.protocol import CameraModel

MAX_POSITION_SIGMA = 0.005
"""A larger standard deviation of the camera's place fails, in metres."""
MAX_ROTATION_SIGMA = float(np.radians(0.1))
"""A larger standard deviation of its rotation fails, in radians."""
_CHANCE = 0.001
_MAX_SURVEY_FACTOR, _MAX_SHIFT = 3.0, 3.0
_SCALE_SIGMAS, _LEAST_SCALE = 4.0, 0.001
_LENSES_EXPLAIN = 0.15
_MAX_RESIDUAL = float(np.radians(0.05))


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """A calibration with all that was checked."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    consensus: Consensus | None = None
    """Where the fit began."""
    solution: Extrinsics | None = None
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


def assess(network: Network, camera: CameraModel, frame: ForkliftFrame | None = None) -> Assessment:
    """Calibrate and check.

    Parameters
    ----------
    network : Network
        The observations of the targets that are seen.
    camera : CameraModel
        Of the shots.
    frame : ForkliftFrame, optional
        Where the forklift stood in the survey; its errors add to the result's.

    Returns
    -------
    Assessment
        Without a solution where the data cannot give one.
    """
    faults = [*(() if frame is None else frame.findings), *size_faults(network.surveys)]
    fault = layout_fault(network.surveys, network.sights)
    if fault is not None or any(one.code == "units" for one in faults):
        return Assessment((*faults, *([fault] if fault else [])))
    consensus = agree(network)
    if consensus is None:
        how = "check that the targets are seen whole and near enough"
        finding = Finding(Severity.DEGENERATE, "no_pose", "no target alone has a pose in the image", how)
        return Assessment((*faults, finding))
    if not all(consensus.agrees) or any(reading is not Reading.AS_NAMED for reading in consensus.readings):
        axes = axis_fault(network)
        if axes is not None:
            return Assessment((*faults, axes), consensus)
    findings = [*faults, *_reading_findings(consensus)]
    trusted, moved = _without_moved(consensus)
    findings += moved
    near = float(consensus.misfit.max()) < _LENSES_EXPLAIN
    lenses = _two_lenses(consensus.network, consensus.poses, camera) if moved and near else None
    if lenses is not None:
        return Assessment((*findings[: -len(moved)], lenses), consensus)
    fault = layout_fault(*_counted(trusted)) if moved else None
    if fault is not None:
        return Assessment((*findings, fault), consensus)
    return _assess_solution(trusted, consensus, camera, frame, findings)


def _assess_solution(
    network: Network,
    consensus: Consensus,
    camera: CameraModel,
    frame: ForkliftFrame | None,
    findings: list[Finding],
) -> Assessment:
    try:
        solution = solve(network, consensus.poses)
    except np.linalg.LinAlgError:
        fault = unobserved(np.full((6, 6), np.inf))
        return Assessment((*findings, *([fault] if fault else [])), consensus)
    fault = unobserved(solution.covariance)
    if fault is not None:
        return Assessment((*findings, fault), consensus, solution)
    left_out = leave_each_out(solution) if sum(network.surveyed) > 1 else ()
    left_out = tuple(one for one, counts in zip(left_out, network.surveyed, strict=True) if counts)
    centres = lens_distance(solution, camera)
    value, sigma = extra_parameter(solution, solution.network.by_survey_scale())
    scale = (-value, sigma)  # the factor that the survey needs is the inverse of how much too large it is
    lenses = None
    if survey_test(_as_stated(solution)) < _CHANCE:
        lenses = _two_lenses(network, consensus.poses, camera)
    if lenses is not None:
        findings.append(lenses)
    else:
        findings += _scale_findings(scale) or _contradictions(solution, left_out, centres)
    if frame is not None:
        solution = solution.with_frame_errors(frame.camera_covariance(solution.poses.camera))
    findings += _limits(solution, left_out)
    return Assessment(tuple(findings), consensus, solution, left_out, centres, scale)


def _as_stated(solution: Extrinsics) -> Extrinsics:
    """Return the solution with the survey's standard deviations as stated."""
    return resolve(solution, replace(solution.network, survey_scale=1.0))


def _two_lenses(network: Network, start: Poses, camera: CameraModel) -> Finding | None:
    """Return the finding that two lens centres explain what one does not, or None."""
    if camera.period_px is None:
        return None
    solution, distance = fit_two_centres(network, start)
    explained = abs(distance) > LEAST_DISTANCE and survey_test(_as_stated(solution)) > _CHANCE
    return apart(distance) if explained else None


def _counted(network: Network) -> tuple[list[Survey], list[Sight]]:
    surveys = [one for one, counts in zip(network.surveys, network.surveyed, strict=True) if counts]
    return surveys, [sight for sight in network.sights if network.surveyed[sight.target]]


def _reading_findings(consensus: Consensus) -> list[Finding]:
    """Return for which targets the corners are named otherwise than the pattern stands."""
    findings = []
    for survey, reading in zip(consensus.network.surveys, consensus.readings, strict=True):
        what = f"target {survey.name}: the surveyed corners fit when they are read as {reading.replace('_', ' ')}"
        if reading is Reading.UPSIDE_DOWN:
            how = "nothing; the board hangs upside down, or its corners are named from below"
            findings.append(Finding(Severity.NOTE, "upside_down", f"{what}; they were read so", how))
        elif reading is not Reading.AS_NAMED:
            how = "name the corners as they are seen from the front of the pattern"
            findings.append(Finding(Severity.FAIL, "corners_swapped", what, how))
    return findings


def _without_moved(consensus: Consensus) -> tuple[Network, list[Finding]]:
    """Return the network in which targets that are centimetres off no longer count, and name them."""
    network, findings = consensus.network, list[Finding]()
    for k, (survey, agrees) in enumerate(zip(network.surveys, consensus.agrees, strict=True)):
        if not agrees:
            findings.append(_moved(survey.name, float(consensus.misfit[k])))
            network = network.without_survey(k)
    return network, findings


def _moved(name: str, distance: float) -> Finding:
    what = f"target {name} is {1000 * distance:.1f} mm away from where it was surveyed; the others agree without it"
    how = f"survey {name} again, check that its ids and its name belong together, or leave it out"
    return Finding(Severity.FAIL, "target_moved", what, how)


def _contradictions(solution: Extrinsics, left_out: Sequence[LeftOut], centres: TwoCentres | None) -> list[Finding]:
    """Return what contradicts what: one target the others, the lenses one centre, or the survey its sigma."""
    lens = None if centres is None else lens_finding(centres)
    suspects = [one for one in left_out if one.probability < _CHANCE / len(left_out)]
    if survey_test(_as_stated(solution)) > _CHANCE:
        found = [_moved(one.target, one.distance) for one in suspects[:1]]
        return found + ([lens] if lens is not None else [])
    if suspects:
        guilty = max(suspects, key=lambda one: one.rest_probability)
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


def _limits(solution: Extrinsics, left_out: Sequence[LeftOut]) -> list[Finding]:
    """Return what is too uncertain, leans on one target, or does not fit the camera model."""
    findings, sigma = [], solution.sigma
    if sigma[:3].max() > MAX_POSITION_SIGMA or sigma[3:].max() > MAX_ROTATION_SIGMA:
        what = (
            f"the pose is known to {1000 * sigma[:3].max():.1f} mm and {np.degrees(sigma[3:].max()):.2f} degrees"
            f" only; the weakest direction is {weakest(solution.covariance)[1]}"
        )
        how = "hang more or larger targets, nearer and on more sides, or survey them more exactly"
        findings.append(Finding(Severity.FAIL, "too_uncertain", what, how))
    leaning = [one for one in left_out if np.abs(one.shift_in_rest_sigma).max() > _MAX_SHIFT]
    for one in leaning if len(left_out) > 2 else ():
        what = f"without target {one.target} the pose moves by {np.abs(one.shift_in_rest_sigma).max():.1f} sigma"
        findings.append(
            Finding(Severity.WARNING, "leans_on_target", what, f"survey {one.target} again, or hang another near it")
        )
    if len(left_out) < 3:
        what = "with two targets a fault in one of them cannot be told from one in the other"
        findings.append(Finding(Severity.WARNING, "no_hold_out", what, "hang a third target"))
    stated = np.concatenate([sight.sigma for sight in solution.network.sights])
    if solution.sight_factor * float(np.median(stated)) > _MAX_RESIDUAL:
        what = f"corners scatter by {np.degrees(solution.sight_factor * np.median(stated)):.3f} degrees"
        how = "check the camera model; for stitched shots use static or saved stitching, not dynamic"
        findings.append(Finding(Severity.WARNING, "camera_model", what, how))
    return findings
