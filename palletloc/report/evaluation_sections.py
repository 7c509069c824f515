"""Sections of an evaluation's page: by distance, by pallet, at surveyed stops, runs side by side, and the survey."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from palletloc.drawing.canvas import DEGREE, SIGMA, small_png
from palletloc.evaluation.breakdown import by_distance, by_pallet, distance_edges
from palletloc.evaluation.pose_error import COMPONENTS, PoseError, offsets
from palletloc.evaluation.run import ComparedRuns, EvaluatedRun, Settings
from palletloc.evaluation.truth import RecordingTruth, survey_notes
from palletloc.report.error_figures import comparison_figure
from palletloc.report.page import Column, embedded, heading, paragraph, picture, table
from palletloc.report.source_style import NONE, QUANTITIES, STYLES
from palletloc.survey.polar import instrument_errors
from palletloc.survey.truth import PlacedBody, SurveyedTruth

GROUPS = (
    Column("source", is_text=True),
    Column("", is_text=True),
    Column("found"),
    *(Column(f"{quantity.label} {quantity.unit}") for quantity in QUANTITIES),
)
"""Columns of the tables by distance and by pallet."""
STOPS = (
    Column("source", is_text=True),
    Column("stop", is_text=True),
    Column("pallet", is_text=True),
    *(Column(name) for name in ("shots", "AP mm", "RP mm", f"AP yaw {DEGREE}", f"RP yaw {DEGREE}")),
    *(Column(f"{SIGMA} {name}") for name in ("depth mm", "along mm", f"yaw {DEGREE}")),
)
"""Columns of the table of surveyed stops."""
_COMPARED = (
    *(Column(name, is_text=True) for name in ("run", "source", "error")),
    *(Column(name) for name in ("change", "from", "to", "better", "worse")),
)
"""Columns of the table of runs side by side."""
_SECOND = "\N{DOUBLE PRIME}"
"""Sign of a second of arc."""
_SURVEY = (
    Column("body", is_text=True),
    Column("targets"),
    Column("residual mm"),
    Column("leave one out mm"),
    Column("", is_text=True),
    Column(f"heading {SIGMA} {DEGREE}"),
)
"""Columns of the table of surveyed bodies."""


def _group(errors: Sequence[PoseError]) -> list[str]:
    """Return the median and the 95 % of each quantity."""
    return [quantity.sizes_text(offsets(errors)) or NONE for quantity in QUANTITIES]


def distance_rows(run: EvaluatedRun, settings: Settings) -> Iterator[list[str]]:
    """Yield a row for each source and bin of distance."""
    edges = distance_edges(settings.bin_width, settings.visibility.max_range)
    for name, source in run.sources.items():
        for part in by_distance(source.shots, edges):
            if part.found.trials:
                where = f"{part.low:g} to {part.high:g} m"
                counted = part.found.counted
                yield [STYLES[name].label, where, counted, *_group(part.errors)]


def pallet_rows(run: EvaluatedRun) -> Iterator[list[str]]:
    """Yield a row for each source and pallet."""
    for name, source in run.sources.items():
        groups = by_pallet(source.errors)
        missed = [face.id for shot in source.shots for face in shot.missed]
        for pallet in sorted({*groups, *missed}):
            errors = groups.get(pallet, ())
            counted = f"{len(errors)} of {len(errors) + missed.count(pallet)}"
            yield [STYLES[name].label, pallet, counted, *_group(errors)]


def stop_rows(run: EvaluatedRun) -> Iterator[list[str]]:
    """Yield a row for each source, stop and pallet."""
    for name, source in run.sources.items():
        for stop in source.stops:
            accuracy, covariance = stop.accuracy, stop.errors[0].truth_covariance
            sigma = np.zeros(4) if covariance is None else np.sqrt(np.diag(covariance))
            yield [
                *(STYLES[name].label, stop.stop, stop.pallet, str(accuracy.n), f"{1000 * accuracy.ap:.1f}"),
                _known(1000 * accuracy.rp, 1),
                _known(math.degrees(accuracy.ap_yaw), 2),
                _known(math.degrees(accuracy.rp_yaw), 2),
                *(f"{1000 * sigma[0]:.1f}", f"{1000 * sigma[1]:.1f}", f"{math.degrees(sigma[3]):.2f}"),
            ]


def _known(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else NONE


def comparison_parts(compared: Sequence[ComparedRuns]) -> Iterator[str]:
    """Yield the part of the page that compares runs."""
    confidence = 100 * compared[0].comparison.confidence
    yield heading("Runs side by side")
    yield paragraph(
        f"Views of a pallet in a shot that {compared[0].first} and the other run both have, paired. Mean change of"
        f" the absolute error, negative where the other run is better, with its {confidence:g} % bootstrap interval;"
        " whole shots are drawn. An interval that holds zero does not tell the runs apart."
    )
    yield table(_COMPARED, (row for runs in compared for row in _compared_rows(runs)))
    for runs in compared:
        alone = len(runs.comparison.only_first), len(runs.comparison.only_second)
        if any(alone):
            text = f"{alone[0]} views are only in {runs.first}, {alone[1]} only in {runs.second}; they take no part."
            yield paragraph(f"{STYLES[runs.source].label}: {text}")
    caption = "Mean changes of the absolute errors with their intervals."
    yield picture(embedded(small_png(comparison_figure(compared))), caption, keep_wide=True)


def _compared_rows(runs: ComparedRuns) -> Iterator[list[str]]:
    names = [runs.second, f"{STYLES[runs.source].label}, {runs.comparison.views} views"]
    for quantity in QUANTITIES:
        difference = runs.comparison.differences.get(COMPONENTS[quantity.column])
        cells = [NONE] * 5
        if difference is not None:
            digits = quantity.digits + 1
            ends = (difference.mean, difference.low, difference.high)
            cells = [_signed(quantity.scale * value, digits) for value in ends]
            cells += [str(difference.smaller), str(difference.larger)]
        yield [*names, f"{quantity.label}, {quantity.unit}", *cells]
        names = ["", ""]


def _signed(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:+.{digits}f}" if math.isfinite(value) else NONE


def survey_parts(surveyed: SurveyedTruth, truth: RecordingTruth, stop_limit: float) -> Iterator[str]:
    """Yield the section about a survey; a shot may be `stop_limit` seconds from the time of its stop."""
    agreement = truth.agreement
    bodies = [*(stop.forklift for stop in surveyed.stops), *surveyed.pallets]
    yield heading("The survey")
    yield paragraph(
        f"The truth is not exact. An error of 1 mm in each of two targets 1.1 m apart turns a front by 0.07{DEGREE}."
        f" Here each coordinate of a target has a standard deviation of {1000 * bodies[0].fit.sigma:.2g} mm; the last"
        " column says how well the heading of each body follows from it. Leave one out, where there are more targets"
        " than needed: how far the one that fits worst is from where the others of its body say it is."
    )
    yield table(_SURVEY, (_body_row(body) for body in bodies))
    errors = instrument_errors(surveyed.survey.faces)
    if errors is not None:
        index, collimation = (3600 * math.degrees(error) for error in errors)
        yield paragraph(
            f"{len(surveyed.survey.faces)} sights in two faces: the instrument's index error is {index:+.1f}{_SECOND}"
            f" and its collimation error {collimation:+.1f}{_SECOND}; the mean of both faces is free of them."
        )
    if agreement:
        worst = max(float(np.abs(pose.normalised).max()) for pose in agreement)
        yield paragraph(
            f"Survey and path agree within {worst:.1f} standard deviations of the survey over {len(agreement)} poses."
        )
    for note in survey_notes(truth, stop_limit):
        yield paragraph(f"Note: {note}")


def _body_row(placed: PlacedBody) -> list[str]:
    known = [
        (1000 * float(out), point.name)
        for out, point in zip(placed.fit.leave_one_out, placed.body.points, strict=True)
        if math.isfinite(out)
    ]
    worst, name = max(known) if known else (math.nan, "")
    return [
        placed.body.label,
        str(len(placed.body.points)),
        f"{1000 * placed.fit.rms:.2f}",
        f"{worst:.2f}" if known else NONE,
        name,
        f"{math.degrees(placed.fit.pose.yaw_sigma):.3f}",
    ]
