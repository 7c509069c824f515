"""The page overview.html of a run: every shot as a thumbnail with outlines, and all pallets from above."""

from __future__ import annotations

import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2

from palletloc.candidate import Fit
from palletloc.drawing.overlay import MEASURED, REFUSED, Mark, draw_thumbnail
from palletloc.explained import IN_WORDS
from palletloc.io.atomic import write_bytes, write_text
from palletloc.io.measurements import NoPose
from palletloc.io.recording import Recording, ShotFile
from palletloc.localizer import Explanation
from palletloc.measurement import PalletMeasurement, Reason, RefusedCandidate
from palletloc.report import page as html
from palletloc.report.plan_svg import Footprint, plan_svg
from palletloc.trajectory import TrajectoryError

OVERVIEW, THUMBNAILS = "overview.html", "overview"
"""Names of the page and of the folder of its pictures."""
_WIDTH, _QUALITY = 480, 80
"""Width of a thumbnail in pixels, and its JPEG quality."""
_OURS = re.compile(r"\d{6,}\.jpg")
"""Names of thumbnails."""
_MOST_PLACES = 3000
"""How many measured pallets the plan draws; of more, some are left out evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class RunOverview:
    """What the page shows of a run."""

    recording: Recording
    """The recording."""
    shots: tuple[ShotFile, ...]
    """What was worked through, in order; with given starts a shot may come back."""
    rows: tuple[PalletMeasurement | NoPose, ...]
    """Those of measurements.csv."""
    refusals: tuple[RefusedCandidate, ...]
    """Those of refusals.csv."""
    skipped: dict[int, str]
    """Why shots could not be used, by their number."""
    left: frozenset[int] = frozenset()
    """Numbers of the shots that an interrupted run did not come to."""
    options: tuple[str, ...] = ()
    """Of the command, for those that explain a shot."""


def thumbnail(explanation: Explanation) -> bytes:
    """Return a small JPEG of a shot with its pallets, and with those that have a pose and were refused."""
    shot, shown = explanation.shot, []
    for outcome in explanation.outcomes:
        if isinstance(outcome, Fit):
            shown.append(Mark(outcome.candidate.model, outcome.pose, MEASURED))
        elif outcome.fit is not None and outcome.reason is not Reason.OVERLAP:
            shown.insert(0, Mark(outcome.candidate.model, outcome.fit.pose, REFUSED))
    small = draw_thumbnail(shot.image, shot.camera, shot.mounting.to_camera, shown, _WIDTH)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def write_thumbnail(folder: Path, number: int, content: bytes) -> None:
    """Write the thumbnail of a shot of a run into the run's folder; raises `OutputError`."""
    write_bytes(folder / THUMBNAILS / _name(number), content)


def write_overview(folder: Path, overview: RunOverview) -> Path:
    """Write the page about a run, and remove thumbnails that an earlier run left.

    Parameters
    ----------
    folder : Path
        Of the run.
    overview : RunOverview
        What it shows.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    pictures = folder / THUMBNAILS
    drawn = {path.name for path in pictures.glob("*.jpg")}
    ours = {_name(number) for number in range(len(overview.shots)) if number not in overview.skipped}
    for name in drawn - ours:
        if _OURS.fullmatch(name):
            (pictures / name).unlink()
    write_text(folder / OVERVIEW, html.page(f"Run: {folder.resolve().name}", _parts(folder, overview, drawn & ours)))
    return folder / OVERVIEW


def _name(number: int) -> str:
    return f"{number:06d}.jpg"


def _parts(folder: Path, overview: RunOverview, drawn: set[str]) -> Iterator[str]:
    found = [row for row in overview.rows if isinstance(row, PalletMeasurement)]
    yield html.heading(f"{overview.recording.folder.resolve().name}: what was found", level=1)
    yield html.paragraph("Green is what was measured, pink what has a pose and was refused.", "lead")
    yield html.key_figures(
        [
            (str(len(found)), "poses of pallets"),
            (str(len(overview.shots) - len(overview.skipped) - len(overview.left)), "shots"),
            (str(len(overview.skipped)), "shots that could not be used"),
            (str(len(overview.refusals)), "places that were given up"),
        ]
    )
    if overview.left:
        yield html.paragraph(f"The run was interrupted: {len(overview.left)} shots are left to do.")
    yield from _plan(overview, found)
    yield from _reasons(overview.refusals)
    yield html.heading("Shots")
    yield html.gallery(_shots(folder, overview, drawn))


def _plan(overview: RunOverview, found: Sequence[PalletMeasurement]) -> Iterator[str]:
    """Draw the pallets where the odometry has the forklift."""
    recording, models = overview.recording, {model.name: model for model in overview.recording.models}
    path, places = [], []
    for shot in overview.shots:
        with suppress(TrajectoryError):
            path.append(recording.odometry.pose_at(shot.time))
    step = max(1, -(-len(found) // _MOST_PLACES))
    for row in found[::step]:
        with suppress(TrajectoryError, KeyError):  # rows of a model that the recording no longer names
            forklift = recording.odometry.pose_at(row.time).transform()
            places.append(Footprint(models[row.model], forklift * row.forklift_from_pallet.transform()))
    if not path:
        return
    yield html.heading("From above")
    caption = (
        "The aisle in the odometry's frame, squares of one metre: shots as dots, the nominal front of the shelf as a"
        " dashed line, each measured pallet with a thick line at its front. Where poses of one pallet from several"
        " shots do not lie on each other, that is their error and the odometry's."
    )
    caption += f" One of {step} poses is drawn." if step > 1 else ""
    yield html.drawing(plan_svg(path, places, recording.shelf), caption)


def _reasons(refusals: Sequence[RefusedCandidate]) -> Iterator[str]:
    if not refusals:
        return
    counts = Counter(str(refusal.reason) for refusal in refusals)
    yield html.heading("What was given up, and why")
    prose = (html.Column(name, is_text=True, wraps=True) for name in ("means", "what to do"))
    columns = (html.Column("reason", is_text=True), *prose, html.Column("places"))
    rows = ([name, *IN_WORDS.get(name, ("", "")), str(count)] for name, count in counts.most_common())
    yield html.table(columns, rows)


def _shots(folder: Path, overview: RunOverview, drawn: set[str]) -> Iterator[html.Tile]:
    found, refused = defaultdict[float, int](int), defaultdict[float, Counter[str]](Counter)
    for row in overview.rows:
        found[row.time] += isinstance(row, PalletMeasurement)
    for refusal in overview.refusals:
        refused[refusal.time][str(refusal.reason)] += 1
    numbers = {shot: number for number, shot in enumerate(overview.recording.shots)}
    for place, shot in enumerate(overview.shots):
        number = numbers[shot]
        pallets = "1 pallet" if found[shot.time] == 1 else f"{found[shot.time]} pallets"
        told = [pallets, *(f"{count} {reason}" for reason, count in refused[shot.time].most_common(3))]
        if place in overview.left:
            continue
        text = overview.skipped.get(place) or ", ".join(told)
        name = _name(place)
        yield html.Tile(
            f"{THUMBNAILS}/{name}" if name in drawn else "",
            f"{number}: {shot.file}, {shot.time:.6g} s",
            text,
            _command(folder, overview, number),
        )


def _command(folder: Path, overview: RunOverview, number: int) -> str:
    """Return what explains a shot."""
    words = ["palletloc", "explain", str(overview.recording.folder), "--shot", str(number)]
    return shlex.join([*words, "--out", str(folder / f"explain-{number}"), *overview.options])
