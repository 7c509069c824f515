"""The page of ``palletloc demo``: what was done, how well it went, and how to go on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palletloc.drawing.canvas import DEGREE, PLUS_MINUS, SIGMA
from palletloc.drawing.stages import Picture
from palletloc.evaluation.pose_error import PoseError, offsets
from palletloc.evaluation.run import SHOTS_SOURCE, EvaluatedRun, EvaluatedSource, Settings
from palletloc.io.tracks import TrackRow
from palletloc.report import page as html
from palletloc.report.source_style import DEPTH, QUANTITIES, STYLES, YAW, Quantity

_COLUMNS = (
    html.Column("pallet", is_text=True),
    html.Column("shot", is_text=True),
    html.Column("range m"),
    *(html.Column(f"{quantity.label} {quantity.unit}") for quantity in QUANTITIES),
)
"""Columns of the table of single shots."""
_TRACKS = (
    html.Column("track"),
    html.Column("model", is_text=True),
    html.Column("shots"),
    *(
        html.Column(name)
        for name in ("x m", "y m", "z m", f"yaw {DEGREE}", f"{PLUS_MINUS} mm", f"{PLUS_MINUS} {DEGREE}")
    ),
)
"""Columns of the table of tracks."""
_SOURCES = (
    html.Column("source", is_text=True),
    html.Column("found"),
    *(html.Column(f"{quantity.label} {quantity.unit}") for quantity in QUANTITIES),
    html.Column(f"within 2 {SIGMA}"),
    html.Column("inside"),
)
"""Columns of the table of sources."""
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
"""What each picture of a step shows, by the beginning of its name."""
_FILES = (
    (html.Link("report.html", "report.html"), "the evaluation: verdict, figures, every stage of the worst shots"),
    (html.Link("metrics.json", "metrics.json"), "the evaluation in numbers"),
    (html.Link("errors.csv", "errors.csv"), "each pose minus the truth, with its standard deviations"),
    (html.Link("measurements.csv", "measurements.csv"), "one row for each pallet and shot: pose, covariance, score"),
    (html.Link("refusals.csv", "refusals.csv"), "candidates that were given up, with the step and the reason"),
    (html.Link("tracks.csv", "tracks.csv"), "one row for each track and shot, as it was known then"),
    (html.Link("tracks_smoothed.csv", "tracks_smoothed.csv"), "the same as all shots together know it"),
    (html.Link("events.csv", "events.csv"), "what became of every measurement and track"),
    ("tracks/, tracks_smoothed/", "the tracks as paths in TUM form"),
    ("pictures/", "the pictures of this page, and explain.json with every number behind them"),
)
"""Files beside the page."""
_OWN = (
    "palletloc track RECORDING --out RUN --smooth            # measurements, and tracks over the shots",
    "palletloc evaluate RECORDING --estimate RUN --out DIR   # errors against the truth, if there is one",
    "palletloc explain RECORDING --shot 0 --out DIR          # pictures like these for one shot",
    "palletloc pallets                                       # the pallet models that are known",
    "palletloc simulate --out RECORDING                      # a recording to try with",
)
"""Commands for a recording of one's own."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the page shows."""

    run: EvaluatedRun
    """Single shots and tracks against the truth."""
    smoothed: EvaluatedSource
    """The tracks as all shots together know them, against the truth."""
    settings: Settings
    """With which they were evaluated."""
    tracks: tuple[TrackRow, ...]
    """Every track as it was last known."""
    size: tuple[int, int]
    """Width and height of a shot, in pixels."""
    seconds_per_shot: float
    """Median time of a shot, without drawing."""
    pictures: tuple[Picture, ...]
    """Of the shot that is explained."""
    explained: str
    """That shot's image."""
    confirm_hits: int
    """How many shots have to agree before a track counts as a pallet."""
    folder: str
    """Where the pictures lie, relative to the page."""

    @property
    def sources(self) -> dict[str, EvaluatedSource]:
        """The sources by the names that the page gives them."""
        named = {STYLES[name].label: source for name, source in self.run.sources.items()}
        return {**named, "tracks, smoothed": self.smoothed}


def demo_page(result: DemoResult) -> str:
    """Return the page that shows a result."""
    parts = (_summary(result), _steps(result), _tracks(result), _truth(result), _next())
    return html.page("palletloc demo", [piece for part in parts for piece in part])


def _summary(result: DemoResult) -> Iterator[str]:
    shots, (width, height) = result.run.sources[SHOTS_SOURCE], result.size
    found = shots.detection.found
    yield html.heading("Where the pallets stand, from 360-degree shots", level=1)
    yield html.paragraph(
        f"A forklift drives along a rack and takes {len(shots.shots)} shots with a 360-degree camera. Each shot alone"
        " tells where every pallet stands and which way it faces, and how sure that is; with the odometry, pallets"
        " are followed from shot to shot. The images are renderings, so the true poses are known exactly, and this"
        " page compares.",
        "lead",
    )
    yield html.key_figures(
        [
            (found.counted, "pallets found that had to be, single shots"),
            (f"{_middle(shots, YAW):.2f}{DEGREE}", "median error of yaw"),
            (f"{_middle(shots, DEPTH):.1f} mm", "median error of depth"),
            (str(shots.detection.false), "poses where no pallet stands"),
            (f"{result.seconds_per_shot:.2f} s", f"per shot of {width} x {height} pixels"),
        ]
    )
    yield _shown(result, "5-overlay", f"{result.explained}: outlines of the measured front faces, and the headings.")


def _middle(source: EvaluatedSource, quantity: Quantity) -> float:
    return float(np.median(np.abs(quantity.values(source.errors)))) if source.errors else float("nan")


def _steps(result: DemoResult) -> Iterator[str]:
    yield html.heading("How one shot is measured")
    yield html.paragraph(
        "Every stage of the shot above. Green is what was measured, yellow what it began with, pink what was given"
        " up. Pallets are named from left to right; the steps are those of one of them."
    )
    names = [drawn.stage.removeprefix("4-face-") for drawn in result.pictures if drawn.stage.startswith("4-face-")]
    for stage, text in _STEPS.items():
        alone = stage in ("1-shelf", "6-plan")
        yield _shown(result, stage if alone else f"{stage}-{names[0] if names else 'P1'}", text)


def _shown(result: DemoResult, stage: str, caption: str) -> str:
    """Return the picture of a stage, or nothing where there is none."""
    for drawn in result.pictures:
        if drawn.stage == stage:
            return html.picture(f"{result.folder}/{drawn.file}", caption, keep_wide=stage != "5-overlay")
    return ""


def _tracks(result: DemoResult) -> Iterator[str]:
    yield html.heading("Followed over the approach")
    yield html.paragraph(
        "The poses of all shots are fused with the odometry. A track is what is known of one pallet up to a shot;"
        " smoothed, it is what all shots together say of that moment."
    )
    yield html.paragraph(later_start(result.confirm_hits))
    caption = "Errors of single shots, tracks and smoothed tracks over the approach."
    yield html.picture("tracks.png", caption, keep_wide=True)
    yield html.paragraph("Every track as it was last known, in the frame of the forklift at that time:")
    yield html.table(_TRACKS, (_track(row) for row in result.tracks))


def later_start(hits: int) -> str:
    """Return why a filter has fewer poses than single shots, where a track counts after so many that agree."""
    return (
        f"The filter starts later than the single shots: a track counts as a pallet only after {hits} shots that"
        " agree, so that no single wrong pose is steered for. Before that, a pallet has poses of single shots, but"
        " none of the filter. The smoother knows the later shots, and reaches back to the first one."
    )


def _track(row: TrackRow) -> list[str]:
    pose, sigma = row.pose, np.sqrt(np.diag(row.covariance))
    return [
        *(str(row.track), row.model, str(row.hits)),
        *(f"{value:.3f}" for value in (pose.x, pose.y, pose.z)),
        f"{np.degrees(pose.yaw):.2f}",
        ", ".join(f"{1000 * value:.1f}" for value in sigma[:3]),
        f"{np.degrees(sigma[3]):.2f}",
    ]


def _truth(result: DemoResult) -> Iterator[str]:
    asked = result.settings.requirement
    yield html.heading("Against the truth")
    yield html.paragraph(
        "Measured minus true: depth is into the shelf, along is to the pallet's left. Median and 95 % of the absolute"
        " errors, how many of all errors lie within two of the standard deviations that the poses state, and how many"
        f" poses are inside what is required by default: {1000 * asked.depth:g} mm and"
        f" {np.degrees(asked.yaw):g}{DEGREE}. The evaluation beside this page, report.html, has more."
    )
    yield html.table(_SOURCES, (_source(name, source) for name, source in result.sources.items()))
    yield html.paragraph(
        "Every single shot; the pallets have the scene's names here. One that is level with the camera shows no"
        " horizontal plane: its face alone gives its yaw, less exactly."
    )
    shots = result.run.sources[SHOTS_SOURCE].shots
    yield html.table(_COLUMNS, (_row(error) for shot in shots for error in (*shot.errors, *shot.beyond)))


def _source(name: str, source: EvaluatedSource) -> list[str]:
    cells = [quantity.sizes_text(offsets(source.errors)) for quantity in QUANTITIES]
    within = np.array([np.abs(error.normalised) <= 2 for error in source.errors])
    counted = f"{100 * within.mean():.0f} %" if within.size else ""
    return [name, source.detection.found.counted, *cells, counted, source.requirement.together.proportion.counted]


def _row(error: PoseError) -> list[str]:
    cells = []
    for quantity in QUANTITIES:
        digits, (value,), (sigma,) = quantity.digits, quantity.values([error]), quantity.sigmas([error])
        cells.append(f"{round(value, digits) + 0.0:+.{digits}f} {PLUS_MINUS} {sigma:.{digits}f}")
    face = error.face
    return [face.id, error.estimate.file, f"{face.range:.2f}", *cells]


def _next() -> Iterator[str]:
    yield html.heading("What lies beside this page")
    yield html.listing(_FILES)
    yield html.heading("Your own recording")
    yield html.paragraph(
        "A recording is a folder: images with their times (shots.csv), the odometry (odometry.csv), and one"
        " recording.yaml that says what the camera is, how it is mounted on the forklift, where the front of the"
        " shelf roughly is, and which pallets to look for. The file docs/files.md describes each of them."
    )
    yield html.commands(_OWN)
