"""What the localizer did in a shot to come to a pose: the pictures of its stages, for a page."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.candidate import Fit, Refusal
from palletloc.choices import Method
from palletloc.drawing.canvas import as_jpeg
from palletloc.drawing.stages import Picture, shelf_pictures, step_pictures
from palletloc.evaluation.pose_error import PalletEstimate
from palletloc.explained import Named, name_candidates
from palletloc.io.recording import Recording, ShotError, ShotFile
from palletloc.io.run_folder import STATUS
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.recording_run import Job

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
    return Job(recording, Localizer(recording.models, method))


def shot_stages(job: Job, entry: ShotFile, estimate: PalletEstimate) -> ShotStages:
    """Draw the stages that lead to a pose.

    The shot is localized again. Where that does not give the pose, because the run had other parameters or its
    own starts, or was made by something else, the stages are those of a measurement that starts from the pose.

    Parameters
    ----------
    job : Job
        The recording with the localizer.
    entry : ShotFile
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
        explanation = job.explain(job.recording.shots.index(entry))
        named = name_candidates(explanation)
        for name, outcome in named:
            if _is_same(outcome, estimate):
                told = f"The stages of the method {method} on the way to {name}."
                return ShotStages(told, tuple(_pictures(explanation, named, (name, outcome))))
    start = Start(estimate.model, estimate.forklift_from_pallet)
    explanation = job.localizer.explain_from(job.recording.shot(entry), [start], job.recording.shelf.levels)
    named = name_candidates(explanation)
    told = (
        f"The method {method} with its default parameters does not give this pose by itself; these are its stages"
        " when it starts there."
    )
    return ShotStages(told, tuple(_pictures(explanation, named, named[0])))


def _is_same(outcome: Fit | Refusal, estimate: PalletEstimate) -> bool:
    if isinstance(outcome, Refusal) or outcome.candidate.model.name != estimate.model:
        return False
    return bool((np.abs(outcome.pose.minus(estimate.forklift_from_pallet)) < _SAME).all())


def _pictures(explanation: Explanation, named: Named, shown: tuple[str, Fit | Refusal]) -> Iterator[Picture]:
    for picture in (*shelf_pictures(explanation, named), *step_pictures([shown], explanation.shot)):
        yield Picture(picture.stage, picture.caption, ".jpg", as_jpeg(picture.content))
