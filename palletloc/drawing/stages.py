"""Every stage of one shot as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palletloc.candidate import Fit, Refusal, last_step, steps_of
from palletloc.drawing.canvas import MEASURED, REFUSED, png
from palletloc.drawing.face_figure import face_figure
from palletloc.drawing.overlay import Mark, cut_out, draw_overlay, region_of_interest
from palletloc.drawing.paper_figures import horizontal_figure, sweep_figure
from palletloc.drawing.plan_figure import plan_figure
from palletloc.drawing.search_figure import search_figure
from palletloc.drawing.shelf_figure import shelf_figure
from palletloc.explained import Named, name_candidates
from palletloc.geometry import Image
from palletloc.localizer import Explanation
from palletloc.paper.horizontal_view import HorizontalView
from palletloc.paper.joint_search import JointSearch
from palletloc.paper.position import Sweep
from palletloc.refinement.search import Search
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot

_WHOLE_WIDTH, _REGION_WIDTH = 1920, 1280
"""Most width of the whole shot and of its part with the pallets, in pixels."""
_JPEG_QUALITY = 90
"""Of the overlays, 0 to 100: outlines stay free of blocks."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as the content of a file."""

    stage: str
    """What it shows, as in its file's name: ``"1-shelf"``, ``"2-yaw-P1"``."""
    caption: str
    """What it shows, in a sentence."""
    suffix: str
    """``".png"`` or ``".jpg"``."""
    content: bytes
    """All of the file."""

    @property
    def file(self) -> str:
        """Name of the file."""
        return self.stage + self.suffix


def stage_pictures(
    explanation: Explanation, shelf: ShelfPlane | None, *, with_refused: bool = False
) -> Iterator[Picture]:
    """Draw every stage of a shot.

    Parameters
    ----------
    explanation : Explanation
        What was found.
    shelf : ShelfPlane or None
        Nominal front plane in the forklift frame, for the map.
    with_refused : bool
        Whether to draw the steps of candidates that were given up, too.

    Yields
    ------
    Picture
        In the order of the stages; drawn one by one.
    """
    named, shot = name_candidates(explanation), explanation.shot
    yield from shelf_pictures(explanation, named)
    drawable = [(name, outcome) for name, outcome in named if np.isfinite(outcome.candidate.start.as_array()).all()]
    steps = [(name, outcome) for name, outcome in drawable if isinstance(outcome, Fit) or with_refused]
    yield from step_pictures(steps, shot)
    # on the shelf, what was given up lies too densely to be distinguished in the shot
    seen = [(name, outcome) for name, outcome in steps if isinstance(outcome, Fit) or not explanation.shelf_views]
    yield from _overlay_pictures(seen, shot)
    placed = [(name, fit.candidate.model, fit.pose, fit.covariance) for name, fit in named if isinstance(fit, Fit)]
    figure = plan_figure(placed, shot.mounting, shelf)
    yield Picture("6-plan", "The pallets and the forklift from above", ".png", png(figure))


def shelf_pictures(explanation: Explanation, named: Named) -> Iterator[Picture]:
    """Draw the shelf's plane, if pallets were looked for there."""
    if explanation.shelf_views:
        figure = shelf_figure(explanation.shelf_views, named)
        yield Picture("1-shelf", "Where pallets were looked for, and where they were found", ".png", png(figure))


def step_pictures(named: Sequence[tuple[str, Fit | Refusal]], shot: Shot) -> Iterator[Picture]:
    """Draw the steps of single candidates, as far as they came.

    Parameters
    ----------
    named : sequence of (str, Fit or Refusal)
        What became of them, with the names to call them by.
    shot : Shot
        The shot.

    Yields
    ------
    Picture
        PNG files: step by step, and in each candidate by candidate.
    """
    for name, outcome in named:
        if steps_of(outcome, HorizontalView):
            content = png(horizontal_figure(name, outcome))
            yield Picture(f"2-yaw-{name}", f"{name}: yaw from the horizontal plane", ".png", content)
    for name, outcome in named:
        if last_step(outcome, Search):
            caption = f"{name}: hypotheses of yaw and distance, scored in the image"
            yield Picture(f"3-search-{name}", caption, ".png", png(search_figure(name, outcome)))
    for name, outcome in named:
        if last_step(outcome, Sweep) or last_step(outcome, JointSearch):
            content = png(sweep_figure(name, outcome))
            yield Picture(f"3-position-{name}", f"{name}: position by the plane sweep", ".png", content)
    for name, outcome in named:
        if last_step(outcome, Search) or last_step(outcome, Sweep) or last_step(outcome, JointSearch):
            caption = f"{name}: front face at the start and as measured, with its edges"
            yield Picture(f"4-face-{name}", caption, ".png", png(face_figure(name, outcome, shot)))


def _overlay_pictures(named: Sequence[tuple[str, Fit | Refusal]], shot: Shot) -> Iterator[Picture]:
    marks = list(_marks(named))
    drawn = draw_overlay(shot.image, shot.camera, shot.mounting.to_camera, marks)
    region = region_of_interest(shot.camera, shot.mounting.to_camera, marks)
    part = _narrowed(cut_out(drawn, region), _REGION_WIDTH)
    yield Picture("5-overlay", "The pallets drawn into the shot", ".jpg", _jpg(part))
    whole = _narrowed(drawn, _WHOLE_WIDTH)
    yield Picture("5-overlay-whole", "The same in the whole image", ".jpg", _jpg(whole))


def _marks(named: Iterable[tuple[str, Fit | Refusal]]) -> Iterator[Mark]:
    """Yield what to draw: candidates that were given up first, below the pallets."""
    for name, outcome in sorted(named, key=lambda pair: isinstance(pair[1], Fit)):
        model, pose = outcome.candidate.model, outcome.candidate.start if outcome.fit is None else outcome.fit.pose
        if isinstance(outcome, Fit):
            yield Mark(model, pose, MEASURED, name)
        else:
            yield Mark(model, pose, REFUSED, name, heading=False)


def _narrowed(image: Image, width: int) -> Image:
    """Return an image that is at most so wide."""
    if image.shape[1] <= width:
        return image
    height = round(image.shape[0] * width / image.shape[1])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _jpg(image: Image) -> bytes:
    _, content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return content.tobytes()
