"""The folder that explains one shot: pictures of every stage, and explain.json with the numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palletloc.candidate import Refusal
from palletloc.drawing.stages import Picture, stage_pictures
from palletloc.explained import IN_WORDS, Named, name_candidates, spoke_against
from palletloc.io.atomic import write_bytes, write_text
from palletloc.io.explanation import explanation_document
from palletloc.io.recording import ShotError
from palletloc.localizer import Explanation
from palletloc.recording_run import Job
from palletloc.report import page as html

NUMBERS, PAGE = "explain.json", "explain.html"
"""Names of the file with the numbers, and of the page."""
_OURS = re.compile(r"(1-shelf|(2-yaw|3-position|3-search|4-face)-[PC]\d+|5-overlay(-whole)?|6-plan)\.(png|jpg)")
"""Names of the pictures: an earlier explanation's are removed, whatever else is there stays."""


@dataclass(frozen=True, slots=True, eq=False)
class WrittenExplanation:
    """What was written about a shot."""

    pictures: tuple[Picture, ...]
    """What was drawn."""
    document: dict[str, Any]
    """The content of explain.json."""


def write_explanation(
    job: Job, explanation: Explanation, folder: Path, *, with_refused: bool = False
) -> WrittenExplanation:
    """Write the pictures of a shot, a page that shows them, and the numbers.

    Parameters
    ----------
    job : Job
        The recording and its localizer.
    explanation : Explanation
        What was found in a shot.
    folder : Path
        Made if missing. Pictures that an earlier call left there are replaced or removed.
    with_refused : bool
        Whether to draw the steps of candidates that were given up, too.

    Returns
    -------
    WrittenExplanation
        What was drawn, and the numbers.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    shelf, localizer = None, job.localizer
    with suppress(ShotError):  # with given starts, a shot can do without odometry
        shelf = job.recording.shelf_at(explanation.shot.time, localizer.config.prior)
    pictures = []
    for picture in stage_pictures(explanation, shelf, with_refused=with_refused):
        write_bytes(folder / picture.file, picture.content)
        pictures.append(picture)
    named = name_candidates(explanation)
    document = explanation_document(explanation, named, str(localizer.method))
    for entry, (_, outcome) in zip(document["candidates"], named, strict=True):
        if isinstance(outcome, Refusal):
            entry["against"] = spoke_against(outcome, localizer.config.verification)
    document["pictures"] = [{"file": picture.file, "shows": picture.caption} for picture in pictures]
    write_text(folder / NUMBERS, json.dumps(document, indent=1, allow_nan=False) + "\n")
    write_text(folder / PAGE, html.page(f"{explanation.shot.file}, explained", _parts(job, named, pictures)))
    written = {picture.file for picture in pictures}
    for path in _left_over(folder):
        if path.name not in written:
            path.unlink()
    return WrittenExplanation(tuple(pictures), document)


def _parts(job: Job, named: Named, pictures: list[Picture]) -> Iterator[str]:
    """Yield the parts of the page."""
    refusals = [(name, outcome) for name, outcome in named if isinstance(outcome, Refusal)]
    yield html.heading(f"{job.recording.folder.resolve().name}: {job.shots[0].file}, stage by stage", level=1)
    found = len(named) - len(refusals)
    yield html.paragraph(f"{found} pallets measured, {len(refusals)} places given up.", "lead")
    words = [html.Column(name, is_text=True) for name in ("", "model", "stage", "reason")]
    sentences = [html.Column(name, is_text=True, wraps=True) for name in ("what spoke against it", "what to do")]
    if refusals:
        yield html.heading("What was given up, and why")
        yield html.table([*words, *sentences], (_row(name, refusal, job) for name, refusal in refusals))
    for picture in pictures:
        yield html.heading(picture.caption)
        yield html.picture(picture.file, picture.caption, keep_wide=picture.suffix == ".png")


def _row(name: str, refusal: Refusal, job: Job) -> list[str]:
    against = spoke_against(refusal, job.localizer.config.verification)
    words = (refusal.candidate.model.name, str(refusal.stage), str(refusal.reason))
    return [name, *words, against, IN_WORDS[refusal.reason][1]]


def _left_over(folder: Path) -> Iterator[Path]:
    """Yield the pictures in a folder that have names of ours."""
    yield from (path for path in folder.iterdir() if _OURS.fullmatch(path.name))
