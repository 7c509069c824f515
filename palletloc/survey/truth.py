"""From a survey to the truth: where every pallet was to the forklift at each stop, with its covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.special import gammaincc

from palletloc.geometry import FloatArray, LevelPose
from palletloc.survey.bodies import SurveyedBody, rejected_text, surveyed_bodies
from palletloc.survey.faults import check_distances, distance_limit
from palletloc.survey.plan import SurveyPlan, read_survey_plan
from palletloc.survey.point import Survey, SurveyError, lines_text
from palletloc.survey.reading import read_survey
from palletloc.survey.rigid_body import (
    BodyFit,
    FitError,
    UncertainPose,
    fit_level,
    fit_rigid,
    is_mirrored,
    relative_pose,
)

_MAX_TILT = math.radians(3.0)
"""Tilt beyond which a body is not standing, in radians."""
_MAX_DISTANCE = 50.0
"""Farthest that a pallet may be from the forklift that approaches it, in metres."""
_IMPROBABLE = 1e-3
"""Probability of residuals below which the stated sigma is too small."""


@dataclass(frozen=True, slots=True, eq=False)
class TruePose:
    """Where a pallet truly is to the forklift."""

    id: str
    """Name of the pallet in the scene."""
    forklift_from_pallet: LevelPose
    """Its pose."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    """(4, 4) covariance of (x, y, z, yaw), in metres and radians; zero where the truth is exact."""

    @property
    def yaw_sigma(self) -> float:
        """Standard deviation of the yaw, in radians."""
        return math.sqrt(self.covariance[3, 3])

    def normalised_error(self, pose: LevelPose, covariance: FloatArray | None = None) -> FloatArray:
        """Return the error of a pose in standard deviations of both together.

        Parameters
        ----------
        pose : LevelPose
            A measured ``forklift_from_pallet``.
        covariance : (4, 4) array, optional
            Its own; None for an exact one.

        Returns
        -------
        (4,) array
            Of x, y, z and yaw.
        """
        both = self.covariance + (0.0 if covariance is None else covariance)
        return self.error(pose) / np.sqrt(np.diag(both))

    def nees(self, pose: LevelPose, covariance: FloatArray | None = None) -> float:
        """Return the squared error of a pose in units of both covariances: 4 on average where they are true."""
        both = self.covariance + (0.0 if covariance is None else covariance)
        error = self.error(pose)
        return float(error @ np.linalg.solve(both, error))

    def error(self, pose: LevelPose) -> FloatArray:
        """Return a pose minus the true one: (4,) of x, y, z and yaw, the yaw in [-pi, pi)."""
        return pose.minus(self.forklift_from_pallet)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBody:
    """A body and its pose in the survey's frame."""

    body: SurveyedBody
    """Its points."""
    fit: BodyFit
    """``world_from_body``, residuals and leave-one-out errors, in the order of the points."""

    @property
    def statement(self) -> str:
        """What the report says about it: how well the points agree, and how well its heading is known."""
        count = len(self.body.points)
        how = "taken to be level" if self.fit.assumed_level else "tilt measured"
        sigma, residual = self.fit.sigma * 1e3, self.fit.rms * 1e3
        heading = math.degrees(self.fit.pose.yaw_sigma)
        return (
            f"{self.body.label}: {count} points of {sigma:.2g} mm, residual {residual:.2g} mm,"
            f" heading known to {heading:.2g} degrees, {how}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedStop:
    """What is true while the forklift stands still."""

    name: str
    """Name of the stop."""
    time: float
    """When, in seconds."""
    forklift: PlacedBody
    """The forklift."""
    poses: tuple[TruePose, ...]
    """Every pallet, with the uncertainty of both bodies."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedTruth:
    """The truth of a recording by a survey."""

    plan: SurveyPlan
    """What was surveyed."""
    survey: Survey
    """The points."""
    stops: tuple[SurveyedStop, ...]
    """In the plan's order."""
    pallets: tuple[PlacedBody, ...]
    """The pallets."""
    variance_factor: float
    """What the residuals make of the variance stated, over all bodies: 1 on average where it is right."""
    notes: tuple[str, ...]
    """Whatever a reader of the result should know, one line each: rejected lines, missing targets, assumptions."""


def read_surveyed_truth(folder: str | Path, columns: Sequence[str] | None = None) -> SurveyedTruth:
    """Read the survey of a recording: truth/survey.yaml and the file that it names.

    Parameters
    ----------
    folder : str or Path
        The recording.
    columns : sequence of str, optional
        What the columns of a table are, from the left; in place of what survey.yaml says.

    Returns
    -------
    SurveyedTruth
        With ``forklift_from_pallet`` for each stop and pallet.

    Raises
    ------
    InputError
        If a file is missing or wrong, or the points do not fit the bodies; names file, line and point.
    """
    plan = read_survey_plan(Path(folder) / "truth" / "survey.yaml")
    return survey_truth(plan, read_survey(plan.survey, plan.prism, plan.known, columns or plan.columns))


def survey_truth(plan: SurveyPlan, survey: Survey) -> SurveyedTruth:
    """Fit every body of a survey and put them into relation.

    Three or more points fix a body's pose with its tilt; two do if it stands level, which is then assumed and noted.
    Where the residuals of all bodies together are too large for the stated sigma, every covariance is enlarged by
    their variance factor, and a note says so.

    Parameters
    ----------
    plan : SurveyPlan
        Bodies, stops and sigma.
    survey : Survey
        The points.

    Returns
    -------
    SurveyedTruth
        With ``forklift_from_pallet`` for each stop and pallet.

    Raises
    ------
    SurveyError
        If points are missing, do not fix a pose, or do not fit the bodies; names file, line and point.
    """
    bodies, notes = surveyed_bodies(plan, survey)
    check_distances(survey, bodies, plan.sigma)
    placed = [PlacedBody(body, _fitted(plan, survey, body)) for body in bodies]
    placed, factor, enlarged = _with_true_variance(placed, plan)
    notes = [*survey.remarks(), *notes, *_level_notes(placed, plan), *enlarged]
    lifts, pallets = placed[: len(plan.stops)], placed[len(plan.stops) :]
    stops = tuple(
        SurveyedStop(stop.name, stop.time, lift, tuple(_relative(survey, lift, pallet) for pallet in pallets))
        for stop, lift in zip(plan.stops, lifts, strict=True)
    )
    _check_sides(survey, stops, pallets)
    return SurveyedTruth(plan, survey, stops, tuple(pallets), factor, tuple(notes))


def _fitted(plan: SurveyPlan, survey: Survey, body: SurveyedBody) -> BodyFit:
    where = f"{survey.path}, {lines_text(body.lines)}"
    level = plan.level or len(body.points) == 2
    try:
        fit = (fit_level if level else fit_rigid)(body.places, body.world, plan.sigma)
    except FitError as error:
        names = ", ".join(point.name for point in body.points)
        hint = "" if level else f"; add a target off the line, or state 'level: true' in {plan.path}"
        if body.missing:
            hint += f"; the survey lacks {', '.join(body.missing)}{rejected_text(survey)}"
        raise SurveyError(f"{where}: {body.label} ({names}): {error}{hint}") from None
    _check_residuals(plan, survey, body, fit)
    sigma = math.sqrt(max(fit.pose.covariance[3, 3], fit.pose.covariance[4, 4]))
    if fit.pose.tilt > max(_MAX_TILT, 5 * sigma):
        raise SurveyError(
            f"{where}: {body.label} tilts by {math.degrees(fit.pose.tilt):.1f} degrees, expected it to stand level;"
            f" {_tilt_hint(body, plan.sigma)}"
        )
    return fit


def _check_residuals(plan: SurveyPlan, survey: Survey, body: SurveyedBody, fit: BodyFit) -> None:
    """Refuse points whose distances are right, but which do not fit all the same: mirrored or tilted ones."""
    off = np.linalg.norm(fit.residuals, axis=1)
    limit = distance_limit(plan.sigma)
    if off.max() <= limit:
        return
    worst = body.points[int(off.argmax())]
    if is_mirrored(body.places, body.world, limit):
        why = "they fit its mirror image: are easting and northing exchanged, or points swapped?"
    else:
        why = f"expected {'a body that stands level' if fit.assumed_level else 'points that fit'}"
    raise SurveyError(
        f"{survey.path}, {lines_text(worst.lines)}: point '{worst.name}' is {off.max() * 1e3:.1f} mm off the fit"
        f" of {body.label}; {why}"
    )


def _tilt_hint(body: SurveyedBody, sigma: float) -> str:
    mirrored = fit_rigid(body.places, body.world[:, [1, 0, 2]], sigma)
    if mirrored.pose.tilt <= _MAX_TILT and mirrored.rms < distance_limit(sigma):
        return "with easting and northing exchanged it does: is the survey left-handed?"
    return f"are points swapped ({', '.join(point.name for point in body.points)})?"


def _with_true_variance(placed: Sequence[PlacedBody], plan: SurveyPlan) -> tuple[list[PlacedBody], float, list[str]]:
    """Return the bodies with enlarged covariances, if their residuals call for it."""
    total, freedom = (
        sum(values) for values in zip(*((body.fit.chi2, body.fit.freedom) for body in placed), strict=True)
    )
    factor = total / freedom if freedom else 1.0
    if not freedom or gammaincc(freedom / 2, total / 2) > _IMPROBABLE:
        return list(placed), factor, []
    note = (
        f"{plan.path}: sigma_m: the residuals of all bodies say {math.sqrt(factor) * plan.sigma * 1e3:.2g} mm, not"
        f" {plan.sigma * 1e3:.2g} mm; covariances are enlarged accordingly"
    )
    return [replace(body, fit=_enlarged(body.fit, factor)) for body in placed], factor, [note]


def _enlarged(fit: BodyFit, factor: float) -> BodyFit:
    pose = UncertainPose(fit.pose.target_from_source, fit.pose.covariance * factor)
    return replace(fit, pose=pose, sigma=fit.sigma * math.sqrt(factor))


def _level_notes(placed: Sequence[PlacedBody], plan: SurveyPlan) -> list[str]:
    if plan.level:
        return [f"{plan.path}: every body is taken to stand level"]
    return [
        f"{body.body.label}: has 2 points and is taken to stand level" for body in placed if body.fit.assumed_level
    ]


def _relative(survey: Survey, lift: PlacedBody, pallet: PlacedBody) -> TruePose:
    pose = relative_pose(lift.fit.pose, pallet.fit.pose)
    distance = float(np.linalg.norm(pose.target_from_source.translation))
    if distance > _MAX_DISTANCE:
        raise SurveyError(
            f"{survey.path}, {lines_text(pallet.body.lines)}: {pallet.body.label} ({pallet.body.points[0].name}) is"
            f" {distance:.1f} m from the forklift at {lift.body.label}, expected at most {_MAX_DISTANCE:.0f} m;"
            " are they surveyed in one frame?"
        )
    return TruePose(pallet.body.name, pose.level, pose.level_covariance)


def _check_sides(survey: Survey, stops: Sequence[SurveyedStop], pallets: Sequence[PlacedBody]) -> None:
    """Refuse a pallet whose back the forklift sees from every stop: its left and right are swapped."""
    for number, pallet in enumerate(pallets):
        poses = [stop.poses[number].forklift_from_pallet for stop in stops]
        if all(-pose.x * math.cos(pose.yaw) - pose.y * math.sin(pose.yaw) > 0 for pose in poses):
            names = ", ".join(point.name for point in pallet.body.points)
            raise SurveyError(
                f"{survey.path}, {lines_text(pallet.body.lines)}: {pallet.body.label} shows the forklift its back at"
                f" every stop; are points swapped ({names})?"
            )
