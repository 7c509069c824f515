"""The shot itself with the measured pallets drawn into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.drawing.outline import place_outline, project_line, sampled
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.pallet import PalletModel

MEASURED, STARTED, REFUSED = "#29e35b", "#ffd21f", "#ff4d7d"
"""On photographs: what was measured, what it began with, and what was given up."""
_SHIFT = 4
"""Binary digits of a pixel's fraction that OpenCV draws with."""
_MARGIN = 0.3
"""Free space around the pallets, in parts of the larger side of their box."""
_MAX_ASPECT, _MIN_ASPECT = 2.6, 1.5
"""Of the region of interest, width over height."""
_LEAST_SHARE = 0.2
"""Least width of the region of interest, in parts of the image's."""
_COARSE = 0.04
"""Step along outlines in small pictures, in metres."""
_SAMPLES = 2
"""How many pixels of a shot a pixel of a small picture is the mean of, in each direction."""
_HEADING = 0.6
"""Length of the line that shows where a pallet faces, in metres."""
_BLACK = (20, 20, 20)
"""Around curves and behind labels, blue-green-red."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A pallet to be drawn."""

    model: PalletModel
    """What it is."""
    forklift_from_pallet: LevelPose
    """Where it is."""
    color: str
    """As ``"#rrggbb"``."""
    label: str = ""
    """A short text beside it; none if empty."""
    heading: bool = True
    """Whether to draw the line that the pallet's x axis makes into the aisle."""
    width: float = 2.0
    """Of its lines, in pixels of an image 1920 high."""
    halo: bool = True
    """Whether a dark border sets it off; without one, a wider mark below it stays visible."""

    @property
    def strokes(self) -> tuple[tuple[tuple[int, int, int], float], ...]:
        """Colour, blue-green-red, and width of what is drawn of each line, the lowest first."""
        line = (_bgr(self.color), self.width)
        return ((_BLACK, self.width + 2.5), line) if self.halo else (line,)


def draw_overlay(
    image: Image, camera: CameraModel, camera_from_forklift: RigidTransform, marks: Sequence[Mark]
) -> Image:
    """Draw the outlines of front faces into a shot, as curves where the camera makes them so.

    Parameters
    ----------
    image : (height, width) or (height, width, 3) array
        The shot; it stays as it is.
    camera : CameraModel
        The camera that took it.
    camera_from_forklift : RigidTransform
        Inverse of its mounting.
    marks : sequence of Mark
        What to draw, the last on top.

    Returns
    -------
    (height, width, 3) array
        In blue-green-red order.
    """
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    canvas = np.asarray(shown, dtype=np.uint8)
    scale = max(1.0, camera.height / 1920)
    for mark in marks:
        lines = place_outline(mark.model, mark.forklift_from_pallet)
        if mark.heading:
            lines.append(_heading(mark.forklift_from_pallet))
        curves = [curve for line in lines for curve in project_line(camera, camera_from_forklift, line)]
        for color, width in mark.strokes:
            _draw_curves(canvas, curves, color, max(1, round(width * scale)))
        if mark.label:
            _draw_label(canvas, camera, camera_from_forklift, mark, scale)
    return canvas


def _heading(pose: LevelPose) -> FloatArray:
    ends = pose.transform().apply(np.array([[0.0, 0.0, 0.0], [-_HEADING, 0.0, 0.0]]))
    return sampled(ends, 0.02)


def _draw_curves(canvas: Image, curves: Sequence[FloatArray], color: Sequence[int], width: int) -> None:
    points = [np.rint(curve * 2**_SHIFT).astype(np.int32).reshape(-1, 1, 2) for curve in curves]
    cv2.polylines(canvas, points, False, color, width, cv2.LINE_AA, _SHIFT)


def draw_thumbnail(
    image: Image, camera: CameraModel, camera_from_forklift: RigidTransform, marks: Sequence[Mark], width: int
) -> Image:
    """Draw outlines into a small picture of the part of a shot around them.

    The shot is made small before anything is drawn, so this costs little of the time that it takes to read one.

    Parameters
    ----------
    image, camera, camera_from_forklift, marks
        Those of `draw_overlay`; labels are not written.
    width : int
        Most width of the picture, in pixels.

    Returns
    -------
    (height, width, 3) array
        In blue-green-red order.
    """
    region = region_of_interest(camera, camera_from_forklift, marks)
    return draw_part(image, camera, camera_from_forklift, marks, region, min(width, region.width))


def draw_part(
    image: Image,
    camera: CameraModel,
    camera_from_forklift: RigidTransform,
    marks: Sequence[Mark],
    region: Region,
    width: int,
) -> Image:
    """Draw outlines into a part of a shot, after it has been made smaller or larger.

    Parameters
    ----------
    image, camera, camera_from_forklift, marks
        Those of `draw_overlay`; labels and headings are not drawn, and lines are half as wide.
    region : Region
        The part.
    width : int
        Of the picture, in pixels.

    Returns
    -------
    (height, width, 3) array
        In blue-green-red order.
    """
    scale = width / region.width
    size = (width, max(1, round(region.height * scale)))
    part = cut_out(image, region)
    if scale < 1 / _SAMPLES:  # the mean over all pixels would take longer than finding the pallets' edges
        part = _resized(part, (_SAMPLES * size[0], _SAMPLES * size[1]), cv2.INTER_NEAREST)
    part = _resized(part, size, cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    canvas = np.asarray(cv2.cvtColor(part, cv2.COLOR_GRAY2BGR) if part.ndim == 2 else part, dtype=np.uint8)
    turns = (0.0,) if camera.period_px is None else (-camera.period_px, 0.0, camera.period_px)
    shifts = [np.array([turn - region.left, -region.top]) for turn in turns]
    for mark in marks:
        lines = place_outline(mark.model, mark.forklift_from_pallet, _COARSE)
        seen = [curve for line in lines for curve in project_line(camera, camera_from_forklift, line)]
        # the middle of the first pixel lies at 0 in both
        placed = ((curve + shift + 0.5) * scale - 0.5 for curve in seen for shift in shifts)
        curves = [curve for curve in placed if curve[:, 0].max() > 0 and curve[:, 0].min() < size[0]]
        for color, thick in mark.strokes:
            _draw_curves(canvas, curves, color, max(1, round(thick / 2)))
    return canvas


def _resized(image: Image, size: tuple[int, int], interpolation: int) -> Image:
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.uint8)


def _draw_label(
    canvas: Image, camera: CameraModel, camera_from_forklift: RigidTransform, mark: Mark, scale: float
) -> None:
    """Write the label on a plate above the middle of the face."""
    point = mark.forklift_from_pallet.transform().apply([0.0, 0.0, mark.model.height + 0.06])
    pixel, valid = camera.project(camera_from_forklift.apply(point))
    if not valid:
        return
    font, size, thick = cv2.FONT_HERSHEY_SIMPLEX, 0.9 * scale, max(1, round(2 * scale))
    (width, height), _ = cv2.getTextSize(mark.label, font, size, thick)
    pad = round(7 * scale)
    left, base = round(float(pixel[0])) - width // 2, round(float(pixel[1])) - pad
    corners = (left - pad, base - height - pad), (left + width + pad, base + pad)
    cv2.rectangle(canvas, *corners, _BLACK, cv2.FILLED)
    cv2.putText(canvas, mark.label, (left, base), font, size, _bgr(mark.color), thick, cv2.LINE_AA)


def write_title(picture: Image, title: str, color: str) -> Image:
    """Return a copy of a picture, (height, width, 3), with a title on a plate in its upper left corner."""
    titled = picture.copy()
    (width, height), _ = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 1)
    cv2.rectangle(titled, (0, 0), (width + 16, height + 16), _BLACK, cv2.FILLED)
    cv2.putText(titled, title, (8, height + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _bgr(color), 1, cv2.LINE_AA)
    return titled


def _bgr(color: str) -> tuple[int, int, int]:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red


@dataclass(frozen=True, slots=True)
class Region:
    """A part of an image; where the image closes around, it may lie across the seam."""

    left: int
    """First column; may be negative across the seam."""
    top: int
    """First row."""
    width: int
    """In pixels."""
    height: int
    """In pixels."""


def region_of_interest(
    camera: CameraModel, camera_from_forklift: RigidTransform, marks: Sequence[Mark], least: float = _LEAST_SHARE
) -> Region:
    """Return the part of the image that shows pallets, with some space around them.

    Parameters
    ----------
    camera, camera_from_forklift, marks
        Those of `draw_overlay`.
    least : float
        Least width of the part, in parts of the image's.

    Returns
    -------
    Region
        The whole image where no mark is seen.
    """
    lines = (line for mark in marks for line in place_outline(mark.model, mark.forklift_from_pallet, 0.05))
    pixels, valid = camera.project(camera_from_forklift.apply(np.concatenate([np.zeros((0, 3)), *lines])))
    seen = pixels[valid]
    if not len(seen):
        return Region(0, 0, camera.width, camera.height)
    if camera.period_px is not None:
        seen[:, 0] = _beside(seen[:, 0], camera.period_px)
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height = (high - low) + 2 * _MARGIN * float((high - low).max())
    width = max(width, _MIN_ASPECT * height, least * camera.width)
    height = max(height, width / _MAX_ASPECT)
    width, height = min(width, camera.width), min(height, camera.height)
    middle = (low + high) / 2
    left = middle[0] - width / 2
    if camera.period_px is None:
        left = np.clip(left, 0, camera.width - width)
    top = np.clip(middle[1] - height / 2, 0, camera.height - height)
    return Region(int(left), int(top), int(width), int(height))


def _beside(columns: FloatArray, period: float) -> FloatArray:
    """Return columns, some of them a turn on, such that the largest gap between them lies outside."""
    ordered = np.sort(columns % period)
    gaps = np.diff(np.append(ordered, ordered[0] + period))
    first = ordered[(int(gaps.argmax()) + 1) % len(ordered)]
    return np.asarray((columns - first) % period + first)


def cut_out(image: Image, region: Region) -> Image:
    """Return a part of an image, (height, width, ...); columns outside come from the other side."""
    rows, period = image[region.top : region.top + region.height], image.shape[1]
    left = region.left % period
    over = left + region.width - period
    if over <= 0:
        return rows[:, left : left + region.width]
    return np.concatenate([rows[:, left:], rows[:, :over]], axis=1)
