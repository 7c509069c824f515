"""The worst shots of a run: true and measured faces drawn into their images, and the localizer's stages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from palletloc.candidate import Fit, Refusal
from palletloc.choices import Method
from palletloc.drawing.canvas import MEASURED, REFUSED, as_jpeg
from palletloc.drawing.overlay import Mark, cut_out, draw_overlay, draw_part, region_of_interest, write_title
from palletloc.drawing.stages import Picture, shelf_pictures, step_pictures
from palletloc.errors import PalletLocError
from palletloc.evaluation.pose_error import PalletEstimate, PoseError
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import SHOTS_SOURCE, EvaluatedRun
from palletloc.explained import Named, name_candidates
from palletloc.geometry import Image
from palletloc.io.recording import Recording, ShotError, ShotFile
from palletloc.io.run_folder import STATUS
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.recording_run import Job

WORST = 4
"""How many are shown, where nothing else is asked."""
_WIDEST, _QUALITY = 1040, 85
"""Most width of a picture in pixels, that of the page, and its JPEG quality: outlines stay sharp to the eye."""
_CLOSE = 0.02
"""Least width of the part of a shot that is enlarged, in parts of the image's."""
_TITLES = ("true", "measured")
"""What the enlarged parts show."""
_SAME = 1e-3
"""Largest difference of a pose that counts as the same, in metres and radians."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotStages:
    """The way to one pose."""

    title: str
    """What the pictures are of, in a sentence."""
    pictures: tuple[Picture, ...]
    """In the order of the stages, as JPEG."""


@dataclass(frozen=True, slots=True, eq=False)
class WorstShot:
    """A pallet in a shot with one of the largest errors."""

    error: PoseError
    """The error."""
    file: str
    """The shot's image."""
    share: float
    """Largest error, in parts of what is allowed."""
    picture: bytes
    """JPEG of the part of the shot around the pallet; empty where the image cannot be read."""
    closer: bytes = b""
    """JPEG of the true face beside the measured one, enlarged; empty where there is no picture."""
    stages: ShotStages | None = None
    """How the localizer came to the pose; None where there is no picture."""
    problem: str = ""
    """Why there is no picture."""


def worst_shots(
    run: EvaluatedRun,
    recording: Recording,
    requirement: Requirement,
    *,
    with_pictures: bool = True,
    number: int | None = None,
) -> list[WorstShot]:
    """Return the single-shot measurements whose errors are the largest parts of what is allowed.

    Parameters
    ----------
    run : EvaluatedRun
        The run.
    recording : Recording
        Gives images, camera and pallet models.
    requirement : Requirement
        What is allowed.
    with_pictures : bool
        Whether to read the images, and to localize the shots once more to draw every stage.
    number : int, optional
        How many; `WORST` if left out.

    Returns
    -------
    list of WorstShot
        The worst first.
    """
    source = run.sources.get(SHOTS_SOURCE)
    errors = sorted(source.errors if source else (), key=lambda error: -_share(error, requirement))
    shots = {shot.time: shot for shot in recording.shots}
    job = _stage_job(recording, run.files.folder)
    found = []
    for error in errors[: WORST if number is None else number]:
        shot = shots[error.time]
        plain = WorstShot(error, shot.file, _share(error, requirement), b"")
        found.append(_drawn(plain, shot, job) if with_pictures else plain)
    return found


def _share(error: PoseError, requirement: Requirement) -> float:
    return float((np.abs(error.offset) / requirement.limits).max())


def _drawn(worst: WorstShot, shot: ShotFile, job: Job) -> WorstShot:
    """Return a shot with its pictures, or with why there is none."""
    try:
        picture, closer = _pictures_of(worst.error, job.recording.image(shot), job.recording)
        stages = _shot_stages(job, shot, worst.error.estimate)
    except PalletLocError as error:
        return replace(worst, problem=str(error))
    return replace(worst, picture=picture, closer=closer, stages=stages)


def _pictures_of(error: PoseError, image: Image, recording: Recording) -> tuple[bytes, bytes]:
    """Return the part of the shot around a pallet, and the true and the measured face enlarged side by side."""
    models = {model.name: model for model in recording.models}
    face, estimate = error.face, error.estimate
    # a measured line runs along the middle of a true one, and both can be seen where they agree
    marks = [Mark(models[face.model], face.forklift_from_pallet, REFUSED, heading=False, width=3.0, halo=False)]
    if estimate.model in models:
        pose = estimate.forklift_from_pallet
        marks.append(Mark(models[estimate.model], pose, MEASURED, heading=False, width=1.0, halo=False))
    camera, camera_from_forklift = recording.camera, recording.forklift_from_camera.inv()
    drawn = draw_overlay(image, camera, camera_from_forklift, marks)
    whole = cut_out(drawn, region_of_interest(camera, camera_from_forklift, marks))
    region = region_of_interest(camera, camera_from_forklift, marks, _CLOSE)
    panels = [
        write_title(draw_part(image, camera, camera_from_forklift, [thin], region, _WIDEST // 2), title, thin.color)
        for thin, title in zip((replace(mark, width=2.0, halo=False) for mark in marks), _TITLES, strict=False)
    ]
    return _jpeg(whole), _jpeg(np.concatenate(panels, axis=1))


def _jpeg(picture: Image) -> bytes:
    if picture.shape[1] > _WIDEST:
        height = round(picture.shape[0] * _WIDEST / picture.shape[1])
        picture = np.asarray(cv2.resize(picture, (_WIDEST, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return content.tobytes()


def run_method(folder: Path) -> Method | None:
    """Return the method of a run that its folder names; None where it names none."""
    with suppress(OSError, ValueError, LookupError, TypeError):
        return Method(json.loads((folder / STATUS).read_text(encoding="utf-8"))["run"]["method"])
    return None


def _stage_job(recording: Recording, folder: Path) -> Job:
    """Return a job with the method that a run's folder names, and default parameters."""
    method = run_method(folder) or Method.REFINED
    return Job(recording, Localizer(recording.models, method))


def _shot_stages(job: Job, entry: ShotFile, estimate: PalletEstimate) -> ShotStages:
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
                title = f"The stages of the method {method} on the way to {name}."
                return ShotStages(title, tuple(_pictures(explanation, named, (name, outcome))))
    start = Start(estimate.model, estimate.forklift_from_pallet)
    explanation = job.localizer.explain_from(job.recording.shot(entry), [start], job.recording.shelf.levels)
    named = name_candidates(explanation)
    title = (
        f"The method {method} with its default parameters does not give this pose by itself; these are its stages"
        " when it starts there."
    )
    return ShotStages(title, tuple(_pictures(explanation, named, named[0])))


def _is_same(outcome: Fit | Refusal, estimate: PalletEstimate) -> bool:
    if isinstance(outcome, Refusal) or outcome.candidate.model.name != estimate.model:
        return False
    return bool((np.abs(outcome.pose.minus(estimate.forklift_from_pallet)) < _SAME).all())


def _pictures(explanation: Explanation, named: Named, shown: tuple[str, Fit | Refusal]) -> Iterator[Picture]:
    for picture in (*shelf_pictures(explanation, named), *step_pictures([shown], explanation.shot)):
        yield Picture(picture.stage, picture.caption, ".jpg", as_jpeg(picture.content))
