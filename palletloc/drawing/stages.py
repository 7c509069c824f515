"""Every stage of one shot as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palletloc.candidate import Candidate, ShotView
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
from palletloc.shelf import ShelfPlane

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
    explanation: Explanation, shot: ShotView, shelf: ShelfPlane | None, *, with_refused: bool = False
) -> Iterator[Picture]:
    """Draw every stage of a shot.

    Parameters
    ----------
    explanation : Explanation
        What was found.
    shot : ShotView
        The shot.
    shelf : ShelfPlane or None
        Nominal front plane in the forklift frame, for the map.
    with_refused : bool
        Whether to draw the steps of candidates that were given up, too.

    Yields
    ------
    Picture
        In the order of the stages; drawn one by one.
    """
    named = name_candidates(explanation)
    yield from shelf_pictures(explanation, named)
    drawable = [(name, candidate) for name, candidate in named if np.isfinite(candidate.start.as_array()).all()]
    steps = [(name, candidate) for name, candidate in drawable if candidate.refusal is None or with_refused]
    yield from step_pictures(steps, shot)
    # on the shelf, what was given up lies too densely to be told apart in the shot
    seen = [
        (name, candidate) for name, candidate in steps if candidate.refusal is None or not explanation.shelf_views
    ]
    yield from _overlay_pictures(seen, shot)
    placed = [
        (name, candidate.model, candidate.pose, candidate.covariance)
        for name, candidate in named
        if candidate.refusal is None and candidate.pose is not None and candidate.covariance is not None
    ]
    figure = plan_figure(placed, shot.mounting, shelf)
    yield Picture("6-plan", "The pallets and the forklift from above", ".png", png(figure))


def shelf_pictures(explanation: Explanation, named: Named) -> Iterator[Picture]:
    """Draw the shelf's plane, if pallets were looked for there."""
    if explanation.shelf_views:
        figure = shelf_figure(explanation.shelf_views, named)
        yield Picture("1-shelf", "Where pallets were looked for, and where they were found", ".png", png(figure))


def step_pictures(named: Sequence[tuple[str, Candidate]], shot: ShotView) -> Iterator[Picture]:
    """Draw the steps of single candidates, as far as they came.

    Parameters
    ----------
    named : sequence of (str, Candidate)
        With the names to call them by.
    shot : ShotView
        The shot.

    Yields
    ------
    Picture
        PNG files: step by step, and in each candidate by candidate.
    """
    for name, candidate in named:
        if candidate.horizontal:
            content = png(horizontal_figure(name, candidate))
            yield Picture(f"2-yaw-{name}", f"{name}: yaw from the horizontal plane", ".png", content)
    for name, candidate in named:
        if candidate.search is not None:
            content = png(search_figure(name, candidate))
            caption = f"{name}: hypotheses of yaw and distance, scored in the image"
            yield Picture(f"3-search-{name}", caption, ".png", content)
    for name, candidate in named:
        if candidate.sweep is not None or candidate.joint is not None:
            content = png(sweep_figure(name, candidate))
            yield Picture(f"3-position-{name}", f"{name}: position by the plane sweep", ".png", content)
    for name, candidate in named:
        if candidate.sweep or candidate.joint or candidate.search:
            content = png(face_figure(name, candidate, shot))
            caption = f"{name}: front face at the start and as measured, with its edges"
            yield Picture(f"4-face-{name}", caption, ".png", content)


def _overlay_pictures(named: Sequence[tuple[str, Candidate]], shot: ShotView) -> Iterator[Picture]:
    marks = list(_marks(named))
    camera, camera_from_forklift = shot.projector.camera, shot.camera_from_forklift
    drawn = draw_overlay(shot.image, camera, camera_from_forklift, marks)
    region = region_of_interest(camera, camera_from_forklift, marks)
    part = _narrowed(cut_out(drawn, region), _REGION_WIDTH)
    yield Picture("5-overlay", "The pallets drawn into the shot", ".jpg", _jpg(part))
    whole = _narrowed(drawn, _WHOLE_WIDTH)
    yield Picture("5-overlay-whole", "The same in the whole image", ".jpg", _jpg(whole))


def _marks(named: Iterable[tuple[str, Candidate]]) -> Iterator[Mark]:
    """Yield what to draw: candidates that were given up first, below the pallets."""
    for name, candidate in sorted(named, key=lambda pair: pair[1].refusal is None):
        if candidate.refusal is not None or candidate.pose is None:
            yield Mark(candidate.model, candidate.pose or candidate.start, REFUSED, name, heading=False)
        else:
            yield Mark(candidate.model, candidate.pose, MEASURED, name)


def _narrowed(image: Image, width: int) -> Image:
    """Return an image that is at most so wide."""
    if image.shape[1] <= width:
        return image
    height = round(image.shape[0] * width / image.shape[1])
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _jpg(image: Image) -> bytes:
    _, content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return content.tobytes()
