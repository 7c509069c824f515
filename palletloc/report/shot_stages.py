"""What the localizer did in a shot to come to a pose: the pictures of its stages, for a page."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.choices import Method
from palletloc.drawing.canvas import as_jpeg
from palletloc.drawing.stages import Picture, shelf_pictures, step_pictures
from palletloc.evaluation.pose_error import PalletEstimate
from palletloc.explained import Named, name_candidates
from palletloc.geometry import Image
from palletloc.io.recording import Recording, Shot
from palletloc.io.run_folder import STATUS
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.offline import Job, ShotError

_SAME = 1e-3
"""Largest difference of a pose that counts as the same, in metres and radians."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotStages:
    """The way to one pose."""

    told: str
    """What the pictures are of, in a sentence."""
    pictures: tuple[Picture, ...]
    """In the order of the stages, as JPEG."""


def run_method(folder: Path) -> Method | None:
    """Return the method of a run as its folder tells it; None where it does not."""
    with suppress(OSError, ValueError, LookupError, TypeError):
        return Method(json.loads((folder / STATUS).read_text(encoding="utf-8"))["run"]["method"])
    return None


def stage_job(recording: Recording, folder: Path) -> Job:
    """Return a job that works as a run did, as far as its folder tells: with its method, and default parameters."""
    method = run_method(folder) or Method.REFINED
    return Job(recording, Localizer(recording.camera, recording.mounting, recording.models, method))


def shot_stages(job: Job, shot: Shot, estimate: PalletEstimate) -> ShotStages:
    """Draw the stages that lead to a pose.

    The shot is localized again. Where that does not give the pose, because the run had other parameters or its
    own starts, or was made by something else, the stages are those of a measurement that starts from the pose.

    Parameters
    ----------
    job : Job
        The recording with the localizer.
    shot : Shot
        The shot.
    estimate : PalletEstimate
        The pose.

    Returns
    -------
    ShotStages
        With no picture where the model is not one of the recording's.

    Raises
    ------
    ImageError
        If the image cannot be read.
    """
    method = job.localizer.method
    with suppress(ShotError):
        image, explanation = job.explain(job.recording.shots.index(shot))
        named = name_candidates(explanation)
        for name, candidate in named:
            if _is_same(candidate, estimate):
                told = f"The stages of the method {method} on the way to {name}."
                return ShotStages(told, tuple(_pictures(job, image, explanation, named, (name, candidate))))
    image, start = job.recording.image(shot), Start(estimate.model, estimate.forklift_from_pallet)
    explanation = job.localizer.explain_from(image, shot.time, [start], job.recording.shelf.levels, shot.file)
    named = name_candidates(explanation)
    told = (
        f"The method {method} with its default parameters does not give this pose by itself; these are its stages"
        " when it starts there."
    )
    return ShotStages(told, tuple(_pictures(job, image, explanation, named, named[0])))


def _is_same(candidate: Candidate, estimate: PalletEstimate) -> bool:
    if candidate.pose is None or candidate.refusal is not None or candidate.model.name != estimate.model:
        return False
    off = candidate.pose.as_array() - estimate.forklift_from_pallet.as_array()
    off[3] = (off[3] + np.pi) % (2 * np.pi) - np.pi
    return bool((np.abs(off) < _SAME).all())


def _pictures(
    job: Job, image: Image, explanation: Explanation, named: Named, shown: tuple[str, Candidate]
) -> Iterator[Picture]:
    mounting = job.localizer.mounting
    shot = ShotView(image, job.localizer.projector, mounting, mounting.forklift_from_camera.inv())
    for picture in (*shelf_pictures(explanation, named), *step_pictures([shown], shot)):
        yield Picture(picture.stage, picture.caption, ".jpg", as_jpeg(picture.content))
