"""The page of ``palletloc demo``: what was done, how well it went, and how to go on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.drawing.stages import Picture
from palletloc.report.comparison import Comparison, MeasuredError
from palletloc.report.page import (
    Column,
    commands,
    heading,
    key_figures,
    listing,
    page,
    paragraph,
    picture,
    table,
)

_DEGREE, _PM = "\N{DEGREE SIGN}", "\N{PLUS-MINUS SIGN}"
_COLUMNS = (
    Column("pallet", is_text=True),
    Column("shot", is_text=True),
    Column("range m"),
    Column("depth mm"),
    Column("along mm"),
    Column("height mm"),
    Column(f"yaw {_DEGREE}"),
    Column("yaw from", is_text=True),
)
_STEPS = {
    "1-shelf": (
        "Detection. The shot is projected onto the nominal front plane of the shelf, where one metre is one metre"
        " everywhere. The full-scale front face of the pallet is matched at every place. Most of the places that"
        " are tried are not pallets; later steps tell."
    ),
    "3-search": (
        "Search. Poses around the place that was detected are scored in the image: are there edges of the right"
        " direction where the face would have them? The map shows the best score at each heading and distance."
    ),
    "4-face": (
        "Edges. From the best places on, each edge of the face is measured to a fraction of a pixel; all together"
        " give the pose and its covariance. Edges that contradict the others are rejected; each is listed with how"
        " far it lies from its place."
    ),
    "6-plan": "The result, in the frame of the forklift, with what is uncertain about it.",
}
_FILES = (
    ("measurements.csv", "one row for each pallet and shot: pose in the forklift frame, covariance, score"),
    ("refusals.csv", "candidates that were given up, with the step and the reason"),
    ("errors.csv", "each measurement minus the truth, with its standard deviations"),
    ("pictures/", "the pictures of this page, and explain.json with every number behind them"),
)
_OWN = (
    "palletloc localize RECORDING --out DIR            # every shot -> measurements.csv",
    "palletloc explain RECORDING --shot 0 --out DIR    # pictures like these for one shot",
    "palletloc pallets                                 # the pallet models that are known",
    "palletloc simulate --out DIR                      # a recording to try with",
)


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the page tells."""

    comparison: Comparison
    """Measurements against the truth."""
    shots: int
    """How many shots there are."""
    size: tuple[int, int]
    """Width and height of a shot, in pixels."""
    seconds_per_shot: float
    """Median time of a shot, without drawing."""
    pictures: tuple[Picture, ...]
    """Of the shot that is explained."""
    explained: str
    """That shot's image."""
    folder: str
    """Where the pictures lie, relative to the page."""
    chart: str
    """The chart of errors, relative to the page."""


def demo_page(result: DemoResult) -> str:
    """Return the page.

    Parameters
    ----------
    result : DemoResult
        What to tell.
    """
    return page("palletloc demo", [*_summary(result), *_steps(result), *_truth(result), *_next()])


def _summary(result: DemoResult) -> Iterator[str]:
    comparison, (width, height) = result.comparison, result.size
    errors, found = comparison.errors, comparison.found
    yield heading("Where the pallets stand, from single 360-degree shots", level=1)
    yield paragraph(
        f"A forklift drives along a rack and takes {result.shots} shots with a 360-degree camera. Each shot alone"
        " tells where every pallet stands and which way it faces, and how sure that is. The images are renderings,"
        " so the true poses are known exactly, and this page compares.",
        "lead",
    )
    yield key_figures(
        [
            (
                f"{found} of {found + len(comparison.missed)}",
                f"pallets found within {comparison.sight.max_range:g} m, all shots",
            ),
            (f"{_median(errors, 3) * 180 / np.pi:.2f}{_DEGREE}", "median error of yaw"),
            (f"{_median(errors, 0) * 1000:.1f} mm", "median error of depth"),
            (str(len(comparison.unmatched)), "poses where no pallet stands"),
            (f"{result.seconds_per_shot:.2f} s", f"per shot of {width} x {height} pixels"),
        ]
    )
    yield _shown(result, "5-overlay", f"{result.explained}: outlines of the measured front faces, and the headings.")


def _steps(result: DemoResult) -> Iterator[str]:
    yield heading("How one shot is measured")
    yield paragraph(
        "Every stage of the shot above. Green is what was measured, yellow what it began with, pink what was given"
        " up. Pallets are named from left to right; the steps are those of one of them."
    )
    names = [one.stage.removeprefix("4-face-") for one in result.pictures if one.stage.startswith("4-face-")]
    for stage, text in _STEPS.items():
        alone = stage in ("1-shelf", "6-plan")
        yield _shown(result, stage if alone else f"{stage}-{names[0] if names else 'P1'}", text)


def _shown(result: DemoResult, stage: str, caption: str) -> str:
    """Return the picture of a stage, or nothing where there is none."""
    for one in result.pictures:
        if one.stage == stage:
            return picture(f"{result.folder}/{one.file}", caption, keep_wide=stage != "5-overlay")
    return ""


def _truth(result: DemoResult) -> Iterator[str]:
    errors = result.comparison.errors
    yield heading("Against the truth")
    covered = np.concatenate([error.is_covered for error in errors]) if errors else np.ones(1)
    yield paragraph(
        "Measured minus true: depth is into the shelf, along is to the pallet's left. Beside each error stands the"
        " standard deviation that the measurement states;"
        f" {100 * float(covered.mean()):.0f} in 100 errors lie within two of them. The pallets have the scene's"
        " names here. One that is level with the camera shows no horizontal plane: its face alone gives its yaw,"
        " less exactly."
    )
    yield picture(result.chart, "Errors of yaw and depth over the approach.", keep_wide=True)
    yield table(_COLUMNS, (_row(error) for error in errors))


def _row(error: MeasuredError) -> list[str]:
    scale = np.array([1000.0, 1000.0, 1000.0, 180 / np.pi])
    decimals = (1, 1, 1, 2)
    cells = [
        f"{round(value, n) + 0.0:+.{n}f} {_PM} {sigma:.{n}f}"
        for value, sigma, n in zip(error.offset * scale, error.sigma * scale, decimals, strict=True)
    ]
    face, measured = error.error.face, error.measured
    source = str(measured.yaw_from).replace("_", " ")
    return [face.id, measured.file, f"{face.range:.2f}", *cells, source]


def _median(errors: Sequence[MeasuredError], axis: int) -> float:
    return float(np.median([abs(error.offset[axis]) for error in errors])) if errors else float("nan")


def _next() -> Iterator[str]:
    yield heading("What lies beside this page")
    yield listing(_FILES)
    yield heading("Your own recording")
    yield paragraph(
        "A recording is a folder: images with their times (shots.csv), the odometry (odometry.csv), and one"
        " recording.yaml that says what the camera is, how it is mounted on the forklift, where the front of the"
        " shelf roughly is, and which pallets to look for. The file docs/files.md describes each of them."
    )
    yield commands(_OWN)
