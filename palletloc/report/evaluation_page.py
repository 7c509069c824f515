"""The page report.html: an evaluation to look at, in one file that opens without a network."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from palletloc.choices import TimeRule
from palletloc.drawing.canvas import DEGREE, small_png
from palletloc.evaluation.batch import BatchJob, BatchResult, evaluate_job
from palletloc.evaluation.pose_error import squared_errors
from palletloc.evaluation.recording import EvaluatedRecording
from palletloc.evaluation.requirement import RequirementCheck, Verdict
from palletloc.evaluation.run import EvaluatedRun, EvaluatedSource, Settings
from palletloc.evaluation.statistics import chi_square_check
from palletloc.evaluation.truth import RecordingTruth
from palletloc.mounting_yaw import turn_lines
from palletloc.report import evaluation_sections as sections
from palletloc.report.approach_figures import aisle_figure, approach_figure
from palletloc.report.error_figures import distance_figure, histogram_figure
from palletloc.report.page import Column, embedded, folded, heading, key_figures, page, paragraph, picture, table
from palletloc.report.source_style import NONE, QUANTITIES, STYLES
from palletloc.report.worst_shots import ShotStages, WorstShot, worst_shots

REPORT = "report.html"
"""Name of the file."""
_VERDICTS = {
    Verdict.MET: "The requirement is met",
    Verdict.NOT_MET: "The requirement is not met",
    Verdict.UNDECIDED: "Too few errors to decide on the requirement",
}
"""The sentence for each verdict."""
_SUMMARY = (
    Column("source", is_text=True),
    Column("error", is_text=True),
    *(Column(name) for name in ("bias", "median", "RMS", "95 %", "largest", "inside")),
    Column("requirement", is_text=True),
)
"""Columns of the table of a run."""


def evaluation_page(evaluated: EvaluatedRecording, *, with_pictures: bool = True, worst: int | None = None) -> str:
    """Return the page of a recording with its runs, with or without images and stages of some worst shots."""
    truth, runs, settings = evaluated.truth, evaluated.runs, evaluated.settings
    name = truth.recording.folder.resolve().name
    parts = [heading(f"{name}: measured against the truth", level=1), *_setting(truth, runs[0], settings)]
    if evaluated.compared:
        parts += sections.comparison_parts(evaluated.compared)
    for run in runs:
        parts += _run(truth, run, settings)
        shown = worst_shots(run, truth.recording, settings.requirement, with_pictures=with_pictures, number=worst)
        parts += _worst(shown)
    if truth.surveyed is not None:
        parts += sections.survey_parts(truth.surveyed, truth, settings.stop_limit)
    return page(f"{name}: evaluation", parts)


def report_job(job: BatchJob, *, with_pictures: bool = True) -> BatchResult:
    """Evaluate one recording and write its metrics.json, errors.csv and report.html.

    Parameters
    ----------
    job : BatchJob
        What to do.
    with_pictures : bool
        Whether the report shows the images and stages of the worst shots.

    Returns
    -------
    BatchResult
        With the problem of a recording that cannot be evaluated; what an earlier call wrote for it is removed.
    """

    def draw(evaluated: EvaluatedRecording) -> dict[str, str]:
        return {REPORT: evaluation_page(evaluated, with_pictures=with_pictures)}

    result = evaluate_job(job, draw)
    if result.problem:
        (job.out / REPORT).unlink(missing_ok=True)
    return result


def _setting(truth: RecordingTruth, run: EvaluatedRun, settings: Settings) -> Iterator[str]:
    asked = settings.requirement
    yield paragraph(
        f"{len(truth.recording.shots)} shots, {len(truth.pallets)} true pallets. A pallet has to be found within"
        f" {settings.visibility.max_range:g} m. Required: depth, along and height within {1000 * asked.depth:g} mm"
        f" and yaw within {math.degrees(asked.yaw):g}{DEGREE}, in {100 * asked.share:g} % of all cases, shown at a"
        f" confidence of {100 * asked.confidence:g} %.",
        "lead",
    )
    if truth.path is None:
        text = f"Truth: the survey at its stops; shots within {settings.stop_limit:g} s of one."
    else:
        between = settings.rule is TimeRule.INTERPOLATED
        how = "between samples at most" if between else "by the nearest sample, at most"
        text = (
            f"Truth: the forklift's path, taken {how} {settings.limit:g} s {'apart' if between else 'away'}"
            f" (largest time to a sample: {run.largest:.3g} s)."
        )
    if run.without_truth:
        text += f" {len(run.without_truth)} of the shots have no truth and are left out."
    yield paragraph(text)


def _run(truth: RecordingTruth, run: EvaluatedRun, settings: Settings) -> Iterator[str]:
    yield heading(run.files.name)
    for line in turn_lines(run.turn):
        yield paragraph(f"{line[0].upper()}{line[1:]}.", "lead")
    for name, source in run.sources.items():
        yield from _verdict(STYLES[name].label, source)
    yield table(_SUMMARY, (row for name, source in run.sources.items() for row in _summary(name, source)))
    caption = "Errors of yaw and distance over the approach, as the method's paper shows them, pallet by pallet."
    yield picture(embedded(small_png(approach_figure(run, settings.requirement))), caption, keep_wide=True)
    caption = "How the errors are spread."
    yield picture(embedded(small_png(histogram_figure(run, settings.requirement))), caption, keep_wide=True)
    caption = "Errors against the pallet's true distance from the camera."
    yield picture(embedded(small_png(distance_figure(run, settings))), caption, keep_wide=True)
    caption = "The aisle from above: true pallets, estimates of all shots, and the forklift's true path."
    yield picture(embedded(small_png(aisle_figure(truth, run))), caption, keep_wide=True)
    yield heading("By distance", level=3)
    yield paragraph("Median and 95 % of the absolute errors.")
    yield table(sections.GROUPS, sections.distance_rows(run, settings))
    yield heading("By pallet", level=3)
    yield table(sections.GROUPS, sections.pallet_rows(run))
    if any(source.stops for source in run.sources.values()):
        yield heading("At the surveyed stops", level=3)
        yield paragraph(
            "Accuracy AP and repeatability RP in the terms of ISO 9283, against the survey; with a single shot at a"
            " stop there is no repeatability. The last columns are the standard deviations of the truth itself; the"
            " end of this page says where they come from."
        )
        yield table(sections.STOPS, sections.stop_rows(run))


def _verdict(label: str, source: EvaluatedSource) -> Iterator[str]:
    check, found = source.requirement, source.detection
    inside = check.together.proportion
    missing = f": {check.together.decision}" if check.together.decision else ""
    yield paragraph(f"{label[0].upper()}{label[1:]}: {_VERDICTS[check.together.verdict].lower()}{missing}.", "lead")
    nees = chi_square_check(squared_errors(source.errors), 4)
    share = f"{100 * inside.low:.1f} to {100 * inside.high:.1f} %"
    figures = [
        (inside.counted, f"errors inside; {share} at {100 * inside.confidence:g} %"),
        (found.found.counted, "pallets found that had to be"),
        (str(found.false), "estimates where no pallet stands"),
    ]
    if nees.n:
        band = f"{nees.low:.1f} to {nees.high:.1f}"
        figures.append((f"{nees.mean:.2f}", f"mean NEES, expected 4 ({band}): {nees.verdict}"))
    yield key_figures(figures)


def _summary(name: str, source: EvaluatedSource) -> Iterator[list[str]]:
    check: RequirementCheck = source.requirement
    for number, quantity in enumerate(QUANTITIES):
        values = quantity.values(source.errors)
        sizes = np.abs(values)
        part = getattr(check, quantity.label)
        numbers = [NONE] * 5
        if len(values):
            found = (
                float(np.median(values)),
                float(np.median(sizes)),
                float(np.sqrt(np.mean(values**2))),
                float(np.percentile(sizes, 95)),
                float(sizes.max()),
            )
            numbers = [f"{value:.2f}" for value in found]
        label = STYLES[name].label if number == 0 else ""
        yield [
            label,
            f"{quantity.label}, {quantity.unit}",
            *numbers,
            part.proportion.counted,
            str(part.verdict).replace("_", " "),
        ]


def _worst(shots: Sequence[WorstShot]) -> Iterator[str]:
    if not shots:
        return
    yield heading("The worst shots", level=3)
    yield paragraph(
        "Single shots with the largest error in parts of what is allowed. In the pictures: wide and pink the true"
        " face, narrow and green the measured one; below, both enlarged beside each other."
    )
    for number, shot in enumerate(shots):
        cells = ", ".join(
            f"{quantity.label} {quantity.values([shot.error])[0]:+.2f} {quantity.unit}" for quantity in QUANTITIES
        )
        face = shot.error.face
        text = (
            f"{shot.file}, pallet {face.id}, {face.range:.2f} m away: {cells}; {shot.share:.2f} of what is allowed."
        )
        if shot.picture:
            yield picture(embedded(shot.picture, "jpeg"), text)
            yield picture(
                embedded(shot.closer, "jpeg"), "The same face: where it truly is, and where it was measured."
            )
        else:
            yield paragraph(text + (f" No picture: {shot.problem}." if shot.problem else ""))
        if shot.stages:
            yield folded(shot.stages.title, _stages(shot.stages), is_open=number == 0)


def _stages(stages: ShotStages) -> Iterator[str]:
    for drawn in stages.pictures:
        yield picture(embedded(drawn.content, "jpeg"), f"{drawn.caption}.", keep_wide=True)
    if not stages.pictures:
        yield paragraph("There is nothing to draw: the recording does not look for pallets of this model.")
