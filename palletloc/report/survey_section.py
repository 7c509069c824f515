"""What an evaluation's page says of the survey behind it: how well its own points agree, and what it knows."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from palletloc.evaluation.truth import RecordingTruth, survey_notes
from palletloc.report.page import Column, heading, paragraph, table
from palletloc.survey.polar import instrument_errors
from palletloc.survey.truth import PlacedBody, SurveyedTruth

_DEGREE, _SIGMA = "\N{DEGREE SIGN}", "\N{GREEK SMALL LETTER SIGMA}"
_SECOND = "\N{DOUBLE PRIME}"
_COLUMNS = (
    Column("body", is_text=True),
    Column("targets"),
    Column("residual mm"),
    Column("leave one out mm"),
    Column("", is_text=True),
    Column(f"heading {_SIGMA} {_DEGREE}"),
)


def survey_parts(surveyed: SurveyedTruth, truth: RecordingTruth, stop_limit: float) -> Iterator[str]:
    """Yield the section about a survey.

    Parameters
    ----------
    surveyed : SurveyedTruth
        The survey.
    truth : RecordingTruth
        Whose survey it is.
    stop_limit : float
        How far a shot may be from the time of its stop, in seconds.
    """
    agreement = truth.agreement
    bodies = [*(stop.forklift for stop in surveyed.stops), *surveyed.pallets]
    yield heading("The survey")
    yield paragraph(
        f"The truth is not exact. An error of 1 mm in each of two targets 1.1 m apart turns a front by 0.07{_DEGREE}."
        f" Here each coordinate of a target has a standard deviation of {1000 * bodies[0].fit.sigma:.2g} mm; the last"
        " column says how well the heading of each body follows from it. Leave one out, where there are more targets"
        " than needed: how far the one that fits worst is from where the others of its body say it is."
    )
    yield table(_COLUMNS, (_row(one) for one in bodies))
    errors = instrument_errors(surveyed.survey.faces)
    if errors is not None:
        index, collimation = (3600 * math.degrees(one) for one in errors)
        yield paragraph(
            f"{len(surveyed.survey.faces)} sights in two faces: the instrument's index error is {index:+.1f}{_SECOND}"
            f" and its collimation error {collimation:+.1f}{_SECOND}; the mean of both faces is free of them."
        )
    if agreement:
        worst = max(float(np.abs(one.normalised).max()) for one in agreement)
        yield paragraph(
            f"Survey and path agree within {worst:.1f} standard deviations of the survey over {len(agreement)} poses."
        )
    for note in survey_notes(truth, stop_limit):
        yield paragraph(f"Note: {note}")


def _row(one: PlacedBody) -> list[str]:
    known = [
        (1000 * float(out), point.name)
        for out, point in zip(one.fit.leave_one_out, one.body.points, strict=True)
        if math.isfinite(out)
    ]
    worst, name = max(known) if known else (math.nan, "")
    return [
        one.body.label,
        str(len(one.body.points)),
        f"{1000 * one.fit.rms:.2f}",
        f"{worst:.2f}" if known else "\N{EN DASH}",
        name,
        f"{math.degrees(one.fit.pose.yaw_sigma):.3f}",
    ]
