"""The worst shots of a run: true and measured faces drawn into their images, and the localizer's stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from palletloc.drawing.canvas import MEASURED, REFUSED
from palletloc.drawing.overlay import Mark, cut_out, draw_overlay, region_of_interest
from palletloc.errors import PalletLocError
from palletloc.evaluation.pose_error import PoseError
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import SHOTS_SOURCE, EvaluatedRun
from palletloc.geometry import Image
from palletloc.io.recording import Recording, ShotFile
from palletloc.recording_run import Job
from palletloc.report.shot_stages import ShotStages, shot_stages, stage_job

WORST = 4
"""How many are shown, where nothing else is asked."""
_WIDEST, _QUALITY = 1040, 85
"""Most width of a picture in pixels, that of the page, and its JPEG quality: outlines stay sharp to the eye."""


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
    job = stage_job(recording, run.files.folder)
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
        picture = _picture(worst.error, job.recording.image(shot), job.recording)
        stages = shot_stages(job, shot, worst.error.estimate)
    except PalletLocError as error:
        return replace(worst, problem=str(error))
    return replace(worst, picture=picture, stages=stages)


def _picture(error: PoseError, image: Image, recording: Recording) -> bytes:
    models = {model.name: model for model in recording.models}
    face, estimate = error.face, error.estimate
    marks = [Mark(models[face.model], face.forklift_from_pallet, REFUSED, heading=False)]
    if estimate.model in models:
        marks.append(Mark(models[estimate.model], estimate.forklift_from_pallet, MEASURED, heading=False))
    return _cut(image, recording, marks)


def _cut(image: Image, recording: Recording, marks: Sequence[Mark]) -> bytes:
    camera, camera_from_forklift = recording.camera, recording.forklift_from_camera.inv()
    drawn = draw_overlay(image, camera, camera_from_forklift, marks)
    part = cut_out(drawn, region_of_interest(camera, camera_from_forklift, marks))
    if part.shape[1] > _WIDEST:
        height = round(part.shape[0] * _WIDEST / part.shape[1])
        part = np.asarray(cv2.resize(part, (_WIDEST, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, content = cv2.imencode(".jpg", part, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return content.tobytes()
