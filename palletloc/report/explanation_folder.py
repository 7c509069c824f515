"""The folder that explains one shot: pictures of every stage, and explain.json with the numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from palletloc.drawing.stages import Picture, stage_pictures
from palletloc.explained import name_candidates
from palletloc.io.atomic import write_bytes, write_text
from palletloc.io.explanation import explanation_document
from palletloc.io.recording import ShotError
from palletloc.localizer import Explanation
from palletloc.recording_run import Job

NUMBERS = "explain.json"
"""Name of the file with the numbers."""
_OURS = re.compile(r"(1-shelf|(2-yaw|3-position|3-search|4-face)-[PC]\d+|5-overlay(-whole)?|6-plan)\.(png|jpg)")
"""Names of the pictures: an earlier explanation's are removed, whatever else is there stays."""


def write_explanation(
    job: Job, explanation: Explanation, folder: Path, *, with_refused: bool = False
) -> tuple[Picture, ...]:
    """Write the pictures and the numbers of a shot.

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
    tuple of Picture
        What was drawn.

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
    document = explanation_document(explanation, name_candidates(explanation), str(localizer.method))
    document["pictures"] = [{"file": picture.file, "shows": picture.caption} for picture in pictures]
    write_text(folder / NUMBERS, json.dumps(document, indent=1, allow_nan=False) + "\n")
    written = {picture.file for picture in pictures}
    for path in _left_over(folder):
        if path.name not in written:
            path.unlink()
    return tuple(pictures)


def _left_over(folder: Path) -> Iterator[Path]:
    """Yield the pictures in a folder that have names of ours."""
    yield from (path for path in folder.iterdir() if _OURS.fullmatch(path.name))
