"""Checks of a mounting: layouts that cannot give it, faults of the survey, and each target left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from calibration.degeneracy import SPREAD
from calibration.findings import Finding, Severity
from calibration.least_squares import redundancies
from calibration.mounting.consensus import own_poses
from calibration.mounting.fit import MountingFit, refit, turn_to
from calibration.mounting.problem import MountingProblem, SurveyedTarget, board_columns
from calibration.targets.observations import CornerObservation
from palletloc.geometry import FloatArray

_LINE = 0.05
"""Targets narrower than this part of their extent lie on a line: the camera may turn about it."""
_WALL = 0.04
"""Targets flatter than this part of their extent lie in a plane."""
_CONE = np.radians(15.0)
"""Targets within this angle of one direction do not tell place from rotation, in radians."""
_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.3701: "inches", 3.28084: "feet"}
"""How many of them a metre has."""
_UNIT_TOLERANCE = 0.05
"""How far the size of a target may be off a unit's factor, relative: the nearest two differ by a factor of 2.5."""
_SIZE_TOLERANCE = 0.01
"""How far a surveyed size may be off the printed one, relative: less than a print that was scaled to a page."""
_SIGMAS = 5.0
"""The same in standard deviations of the survey, where that is more."""
_SKEW_TOLERANCE = 0.02
"""How far the cosine of the surveyed corners' angle may be off zero: about one degree."""
_MIRROR_GAIN = 0.3
"""A mirrored survey fits with less than this part of the misfit of the right one."""
_MIRROR_SCALE = 0.2
"""How far the scale of the mirrored fit may be off one."""


def layout_fault(surveys: Sequence[SurveyedTarget], observations: Sequence[CornerObservation]) -> Finding | None:
    """Return why the layout of the targets that are seen is degenerate, or None."""
    if not surveys:
        how = "check the shots, the dictionary and the ids; a marker needs a side of about 20 px in the shot"
        return Finding(Severity.DEGENERATE, "no_target_seen", "no target is seen in any shot", how)
    if len(surveys) == 1:
        what = f"only one target is seen ({surveys[0].name}): place and direction of the camera cannot be told apart"
        return Finding(Severity.DEGENERATE, "one_target", what, SPREAD)
    points = np.concatenate([_outline(survey) for survey in surveys])
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if extent[1] < _LINE * extent[0]:
        what = "all targets lie on one straight line: the camera may turn about it"
        return Finding(Severity.DEGENERATE, "collinear", what, SPREAD)
    if extent[2] < _WALL * extent[0]:
        what = "all targets lie in one plane, such as one wall: the camera's place is coupled with its rotation"
        return Finding(Severity.DEGENERATE, "one_wall", what, SPREAD)
    angle = _cone_angle(np.concatenate([corners.bearings for corners in observations]))
    if angle < _CONE:
        what = f"all targets lie within {np.degrees(angle):.0f} degrees of one direction, seen from the camera"
        return Finding(Severity.DEGENERATE, "narrow_cone", what, SPREAD)
    return None


def _outline(survey: SurveyedTarget) -> FloatArray:
    left, right, lower = survey.points
    return np.array([left, right, lower, right + lower - left])


def _cone_angle(bearings: FloatArray) -> float:
    """Return the angle between the middle of the bearings, (n, 3), and the farthest of them, in radians."""
    middle = bearings.mean(0)
    length = float(np.linalg.norm(middle))
    if length < 0.1:
        return np.pi
    return float(np.arccos(np.clip((bearings @ middle).min() / length, -1.0, 1.0)))


def size_faults(surveys: Sequence[SurveyedTarget]) -> list[Finding]:
    """Return for which of all targets the surveyed corners do not have the size of the pattern."""
    ratios = {survey.name: _ratio(survey) for survey in surveys}
    for factor, unit in _UNITS.items():
        names = [name for name, ratio in ratios.items() if abs(ratio / factor - 1) < _UNIT_TOLERANCE]
        if names:
            what = f"{_listed(names)}: the surveyed corners are {factor:g} times as far apart as the pattern is large"
            how = f"give corners_m in metres; they seem to be in {unit}"
            return [Finding(Severity.FAIL, "units", what, how)]
        names = [name for name, ratio in ratios.items() if abs(ratio * factor - 1) < _UNIT_TOLERANCE]
        if names:
            what = f"{_listed(names)}: the pattern is {factor:g} times as large as the surveyed corners are apart"
            return [Finding(Severity.FAIL, "units", what, f"give the pattern's sizes in metres, not in {unit}")]
    faults = (_size_fault(survey) for survey in surveys)
    return [fault for fault in faults if fault is not None]


def _ratio(survey: SurveyedTarget) -> float:
    size = np.linalg.norm(survey.outline[1:] - survey.outline[0])
    return float(np.linalg.norm(survey.points[1:] - survey.points[0]) / size)


def _size_fault(survey: SurveyedTarget) -> Finding | None:
    """Return which edge or angle of one target's corners is wrong."""
    printed, measured = (p[1:] - p[0] for p in (survey.outline, survey.points))
    wanted, lengths = np.linalg.norm(printed, axis=1), np.linalg.norm(measured, axis=1)
    tolerance = np.maximum(_SIGMAS * np.sqrt(2) * survey.sigma, _SIZE_TOLERANCE * wanted)
    how = "print at true scale (check the ruler), and survey the outer corners of the printed squares"
    for name, length, want, off in zip(("width", "height"), lengths, wanted, tolerance, strict=True):
        if abs(length - want) > off:
            what = f"target {survey.name}: the surveyed {name} is {length:.4f} m, the pattern's is {want:.4f} m"
            return Finding(Severity.FAIL, "target_size", what, how)
    if lengths.min() > 0:
        skew = float(measured[0] @ measured[1] / lengths.prod())
        if abs(skew) > max(_SIGMAS * 2 * survey.sigma / float(lengths.min()), _SKEW_TOLERANCE):
            angle = np.degrees(np.arccos(np.clip(skew, -1, 1)))
            what = f"target {survey.name}: the surveyed corners make an angle of {angle:.1f} degrees, not of 90"
            return Finding(Severity.FAIL, "target_size", what, how)
    return None


def axis_fault(problem: MountingProblem) -> Finding | None:
    """Return whether the survey of two targets or more fits them in the image only when it is mirrored."""
    own = own_poses(problem.observations, len(problem.surveys))
    pairs = [(survey, pose) for survey, pose in zip(problem.surveys, own, strict=True) if pose is not None]
    if len(pairs) < 2:
        return None
    seen = np.concatenate([pose.apply(survey.outline) for survey, pose in pairs])
    surveyed = np.concatenate([survey.points for survey, _ in pairs])
    rigid, _ = _similarity(seen, surveyed, mirrored=False)
    mirror, mirror_scale = _similarity(seen, surveyed, mirrored=True)
    if mirror < _MIRROR_GAIN * rigid and abs(mirror_scale - 1) < _MIRROR_SCALE:
        what = (
            "the survey fits the image only when mirrored: its axes are left-handed"
            f" ({mirror * 1000:.0f} mm instead of {rigid * 1000:.0f} mm)"
        )
        how = "check the order and the signs of the coordinates: x forward, y left, z up"
        return Finding(Severity.FAIL, "mirrored_axes", what, how)
    return None


def _similarity(source: FloatArray, target: FloatArray, *, mirrored: bool) -> tuple[float, float]:
    """Return the distance that remains after the best similarity, in the target's units, and its scale.

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE TPAMI
    13(4), 1991, with the sign of the determinant chosen.
    """
    a, b = source - source.mean(0), target - target.mean(0)
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(left @ right)) * (-1 if mirrored else 1)
    rotation = left * sign @ right
    scale = float(values @ sign / (a * a).sum())
    return float(np.sqrt(((b - scale * a @ rotation.T) ** 2).sum(-1).mean())), scale


def _listed(names: Sequence[str]) -> str:
    return f"target{'s' if len(names) > 1 else ''} {', '.join(names)}"


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """One target left out."""

    target: str
    """Its name."""
    shift: FloatArray
    """(6,) how the camera's pose moves without it, in metres and radians."""
    shift_in_sigma: FloatArray
    """(6,) the same, in units of the full solution's standard deviations."""
    shift_in_rest_sigma: FloatArray
    """(6,) the same, in units of the standard deviations without it."""
    distance: float
    """Between its surveyed corners and where the others expect them, root mean square, in metres."""
    probability: float
    """Of such a distance or a larger one by chance."""
    rest_probability: float
    """Of the remaining survey's contradictions by chance."""


def survey_test(solution: MountingFit) -> float:
    """Return how probable the survey's residuals are by chance, with the standard deviations as stated."""
    problem = solution.problem
    jacobian = problem.jacobian(solution.poses)[problem.image_rows :]
    residuals = problem.residuals(solution.poses)[problem.image_rows :]
    redundancy = float(redundancies(jacobian, solution.full_covariance).sum())
    return float(chi2.sf(residuals @ residuals, redundancy)) if redundancy > 0.5 else 1.0


def leave_each_out(solution: MountingFit) -> tuple[LeftOut, ...]:
    """Leave out one target after the other.

    The target stays in the fit, but nothing holds it: where it ends up is where the others expect it.

    Parameters
    ----------
    solution : MountingFit
        With all targets, two at least.
    """
    problem = replace(solution.problem, survey_scale=1.0)
    return tuple(_left_out(solution, problem, k) for k in range(len(problem.surveys)))


def _left_out(solution: MountingFit, problem: MountingProblem, target: int) -> LeftOut:
    rest = refit(solution, problem.without_survey(target))
    survey, pose = problem.surveys[target], rest.poses.boards[target]
    off = pose.apply(survey.outline) - survey.points
    rows, columns = problem.predicted_rows(target, rest.poses), board_columns(target)
    covariance = rows @ rest.full_covariance[columns, columns] @ rows.T + survey.sigma**2 * np.eye(9)
    distance = float(off.ravel() @ np.linalg.solve(covariance, off.ravel()))
    moved = rest.poses.camera.translation - solution.poses.camera.translation
    turned = turn_to(solution.poses.camera.rotation, rest.poses.camera.rotation)
    shift = np.concatenate([moved, turned])
    return LeftOut(
        survey.name,
        shift,
        shift / solution.sigma,
        shift / np.maximum(rest.sigma, solution.sigma),
        float(np.sqrt((off**2).sum(-1).mean())),
        float(chi2.sf(distance, 9)),
        survey_test(rest),
    )
