"""The tables of an evaluation's page: by distance, by pallet, at surveyed stops, and runs side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from palletloc.drawing.canvas import small_png
from palletloc.evaluation.breakdown import by_distance, by_pallet, distance_edges
from palletloc.evaluation.pose_error import COMPONENTS, PoseError
from palletloc.evaluation.run import ComparedRuns, EvaluatedRun, Settings
from palletloc.report.comparison_figure import comparison_figure
from palletloc.report.page import Column, embedded, heading, paragraph, picture, table
from palletloc.report.source_style import QUANTITIES, STYLES

_DEGREE, _SIGMA = "\N{DEGREE SIGN}", "\N{GREEK SMALL LETTER SIGMA}"
GROUPS = (
    Column("source", is_text=True),
    Column("", is_text=True),
    Column("found"),
    *(Column(f"{one.label} {one.unit}") for one in QUANTITIES),
)


def _group(errors: Sequence[PoseError]) -> list[str]:
    """Return the median and the 95 % of each quantity."""
    cells = []
    for quantity in QUANTITIES:
        sizes = np.abs(quantity.values(errors))
        digits = 2 if quantity.unit == _DEGREE else 1
        numbers = (np.median(sizes), np.percentile(sizes, 95)) if len(sizes) else ()
        cells.append(" / ".join(f"{value:.{digits}f}" for value in numbers) or "\N{EN DASH}")
    return cells


def distance_rows(run: EvaluatedRun, settings: Settings) -> Iterator[list[str]]:
    """Yield a row for each source and bin of distance."""
    edges = distance_edges(settings.bin_width, settings.visibility.max_range)
    for name, source in run.sources.items():
        for one in by_distance(source.shots, edges):
            if one.found.trials:
                where = f"{one.low:g} to {one.high:g} m"
                counted = f"{one.found.successes} of {one.found.trials}"
                yield [STYLES[name].label, where, counted, *_group(one.errors)]


def pallet_rows(run: EvaluatedRun) -> Iterator[list[str]]:
    """Yield a row for each source and pallet."""
    for name, source in run.sources.items():
        groups = by_pallet(source.errors)
        missed = [face.id for shot in source.shots for face in shot.missed]
        for pallet in sorted({*groups, *missed}):
            errors = groups.get(pallet, ())
            counted = f"{len(errors)} of {len(errors) + missed.count(pallet)}"
            yield [STYLES[name].label, pallet, counted, *_group(errors)]


STOPS = (
    Column("source", is_text=True),
    Column("stop", is_text=True),
    Column("pallet", is_text=True),
    *(Column(name) for name in ("shots", "AP mm", "RP mm", f"AP yaw {_DEGREE}", f"RP yaw {_DEGREE}")),
    *(Column(f"{_SIGMA} {name}") for name in ("depth mm", "along mm", f"yaw {_DEGREE}")),
)


def stop_rows(run: EvaluatedRun) -> Iterator[list[str]]:
    """Yield a row for each source, stop and pallet."""
    for name, source in run.sources.items():
        for stop in source.stops:
            one, covariance = stop.accuracy, stop.errors[0].truth_covariance
            sigma = np.zeros(4) if covariance is None else np.sqrt(np.diag(covariance))
            yield [
                *(STYLES[name].label, stop.stop, stop.pallet, str(one.n), f"{1000 * one.ap:.1f}"),
                _known(1000 * one.rp, 1),
                _known(math.degrees(one.ap_yaw), 2),
                _known(math.degrees(one.rp_yaw), 2),
                *(f"{1000 * sigma[0]:.1f}", f"{1000 * sigma[1]:.1f}", f"{math.degrees(sigma[3]):.2f}"),
            ]


def _known(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else "\N{EN DASH}"


_COMPARED = (
    *(Column(name, is_text=True) for name in ("run", "source", "error")),
    *(Column(name) for name in ("change", "from", "to", "better", "worse")),
)


def comparison_parts(compared: Sequence[ComparedRuns]) -> Iterator[str]:
    """Yield the part of the page that compares runs."""
    confidence = 100 * compared[0].comparison.confidence
    yield heading("Runs side by side")
    yield paragraph(
        f"Views of a pallet in a shot that {compared[0].first} and the other run both have, paired. Mean change of"
        f" the absolute error, negative where the other run is better, with its {confidence:g} % bootstrap interval;"
        " whole shots are drawn. An interval that holds zero does not tell the runs apart."
    )
    yield table(_COMPARED, (row for one in compared for row in _compared_rows(one)))
    for one in compared:
        alone = len(one.comparison.only_first), len(one.comparison.only_second)
        if any(alone):
            told = f"{alone[0]} views are only in {one.first}, {alone[1]} only in {one.second}; they take no part."
            yield paragraph(f"{STYLES[one.source].label}: {told}")
    caption = "Mean changes of the absolute errors with their intervals."
    yield picture(embedded(small_png(comparison_figure(compared))), caption, keep_wide=True)


def _compared_rows(one: ComparedRuns) -> Iterator[list[str]]:
    names = [one.second, f"{STYLES[one.source].label}, {one.comparison.views} views"]
    for quantity in QUANTITIES:
        difference = one.comparison.differences.get(COMPONENTS[quantity.column])
        cells = ["\N{EN DASH}"] * 5
        if difference is not None:
            digits = 3 if quantity.unit == _DEGREE else 2
            ends = (difference.mean, difference.low, difference.high)
            cells = [_signed(quantity.scale * value, digits) for value in ends]
            cells += [str(difference.smaller), str(difference.larger)]
        yield [*names, f"{quantity.label}, {quantity.unit}", *cells]
        names = ["", ""]


def _signed(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:+.{digits}f}" if math.isfinite(value) else "\N{EN DASH}"
