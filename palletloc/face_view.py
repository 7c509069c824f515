"""The front face as the camera sees it, with every edge measured to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.edge_fit import EdgeFit, EdgePeaks, edge_peaks, fit_edges, join_peaks
from palletloc.face import EdgeKind, EdgeShift, FaceEdge, FaceLine, edge_shift, face_lines
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.matching import Energy, gradient_across
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.pixel_size import pixel_sizes
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView, place_plane
from palletloc.projection import Interpolation, Projector

MIN_DISTANCE = 0.2
"""Least distance of the camera from the face's plane, in metres."""
MARGIN = 0.06
"""How far the view reaches beyond the face, in metres."""
END_PIXELS = 1.0
"""How many pixels of the camera's image at each end of an edge are left out."""
SMOOTHING_PIXELS = (0.6, 1.0)
"""Smoothing before the gradient across and along an edge, in pixels of the camera's image."""
PIXEL_ERROR = 0.05
"""What an edge's offset is uncertain by beyond its scatter, in pixels of the camera's image."""
NEIGHBOUR_ERROR = 2.0
"""How far a parallel edge in the same place would draw a peak, in pixels of the camera's image."""
NEIGHBOUR_PIXELS = 1.5
"""Over how many pixels the influence of a parallel edge falls to a third."""


@dataclass(frozen=True, slots=True)
class MeasuredEdge:
    """One line of the face and what was measured of it."""

    edge: FaceEdge
    """The line, from its first to its last end."""
    fit: EdgeFit
    """Its offset and slope on the face, against where a camera should see it."""
    sigma: float
    """Standard deviation of the offset from noise, resolution and tolerances, in metres."""
    shift: EdgeShift
    """Where a camera should see it against the drawn edge, and how sure that is."""
    pixel: float
    """Size of a pixel of the camera's image across the edge, in metres."""


@dataclass(frozen=True, slots=True)
class FaceView:
    """A view of the front face and its edges."""

    view: PlaneView
    """The image."""
    plane_from_camera: FloatArray
    """(3,) the camera's centre in the face's coordinates: right, up, towards the viewer, in metres."""
    edges: tuple[MeasuredEdge, ...]
    """The edges that are seen."""
    expected: int
    """How many edges the camera should see; without the upper edge from above, where a load may begin."""

    def loaded(self, edge: FaceEdge) -> bool:
        """Tell whether a load may begin at an edge: at the upper one, seen from above."""
        return edge.kind is EdgeKind.TOP and bool(self.plane_from_camera[1] > edge.middle[1])


def view_face(
    projector: Projector,
    image: Image,
    camera_from_forklift: RigidTransform,
    pose: LevelPose,
    model: PalletModel,
    finest: float,
) -> FaceView | Reason:
    """Project the shot on the plane of the face, without measuring anything yet.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    camera_from_forklift : RigidTransform
        Inverse of the camera's mounting.
    pose : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    finest : float
        Least metres per pixel of the view; where the camera's pixels are larger, half of one is enough.

    Returns
    -------
    FaceView or Reason
        Without edges; `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where the face is not wholly seen.
    """
    camera_from_plane = place_plane(camera_from_forklift, pose, PALLET_FROM_VERTICAL)
    camera = np.asarray(camera_from_plane.inv().translation)
    if camera[2] < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    center = np.array([[0.0, model.height / 2]])
    up = float(pixel_sizes(projector.camera, camera_from_plane, center, np.array([[0.0, 1.0]]))[0])
    resolution = float(np.clip(up / 2, finest, 2.5 * finest))
    half = model.width / 2 + MARGIN
    grid = PlaneGrid.spanning(-half, half, -MARGIN, model.height + MARGIN, resolution)
    view = projector.view(image, camera_from_plane, grid, Interpolation.LINEAR)
    if not view.valid.all():
        return Reason.OUT_OF_VIEW
    seen = FaceView(view, camera, (), 0)
    return replace(seen, expected=sum(not seen.loaded(line.whole) for line in visible_lines(model, camera)))


def visible_lines(model: PalletModel, plane_from_camera: FloatArray) -> list[FaceLine]:
    """Return the lines to measure: from below, a beam hides the lower edge and would be taken for it."""
    below = plane_from_camera[1] < 0
    return [line for line in face_lines(model) if not (below and line.kind is EdgeKind.BOTTOM)]


def measure_edges(
    projector: Projector,
    seen: FaceView,
    model: PalletModel,
    level_reach: float,
    upright_reach: float,
    reach_px: float,
) -> list[MeasuredEdge]:
    """Measure the edges of a face.

    Parameters
    ----------
    projector : Projector
        Of the camera.
    seen : FaceView
        From `view_face`.
    model : PalletModel
        The pallet.
    level_reach, upright_reach : float
        How far level and upright edges are looked for, in metres.
    reach_px : float
        The same in pixels of the camera's image: the larger holds.

    Returns
    -------
    list of MeasuredEdge
        Those of which enough is seen for a line.
    """
    plane = seen.view.camera_from_plane
    center = np.array([[0.0, model.height / 2]])
    right = float(pixel_sizes(projector.camera, plane, center, np.array([[1.0, 0.0]]))[0])
    up = float(pixel_sizes(projector.camera, plane, center, np.array([[0.0, 1.0]]))[0])
    lines = visible_lines(model, seen.plane_from_camera)
    level = [line for line in lines if line.whole.horizontal]
    upright = [line for line in lines if not line.whole.horizontal]
    return [
        *_measure(seen, level, model, (up, right), max(level_reach, reach_px * up)),
        *_measure(seen, upright, model, (right, up), max(upright_reach, reach_px * right)),
    ]


def _measure(
    seen: FaceView, lines: Sequence[FaceLine], model: PalletModel, pixel: tuple[float, float], reach: float
) -> list[MeasuredEdge]:
    """Measure lines of one direction; ``pixel`` holds the sizes of the camera's pixels across and along them."""
    if not lines:
        return []
    across, along = pixel
    whole = [line.whole for line in lines]
    shifts = [edge_shift(edge, seen.plane_from_camera, model) for edge in whole]
    # an upright edge stays upright: only level ones may tilt, by the yaw
    tilt = None if whole[0].horizontal else np.array([0.5 * across / edge.length for edge in whole])
    peaks = _peaks(seen, lines, np.array([shift.mean for shift in shifts]), pixel, reach)
    fits = fit_edges(peaks, np.full(len(lines), across), np.full(len(lines), along), reach, tilt)
    return [
        MeasuredEdge(
            edge,
            fit,
            float(np.sqrt(fit.sigma_offset**2 + model.tolerance**2 + _blurred(edge, model, across) ** 2)),
            shift,
            across,
        )
        for edge, fit, shift in zip(whole, fits, shifts, strict=True)
        if fit is not None
    ]


def _blurred(edge: FaceEdge, model: PalletModel, pixel: float) -> float:
    """Return what an offset is uncertain by beyond its scatter: edges a few pixels apart draw each other's peaks."""
    ups = {line.whole.start[1] for line in face_lines(model) if line.whole.horizontal}
    gaps = [abs(up - edge.start[1]) for up in ups if up != edge.start[1]] if edge.horizontal else []
    return pixel * (
        PIXEL_ERROR + NEIGHBOUR_ERROR * float(np.exp(-min(gaps, default=np.inf) / (NEIGHBOUR_PIXELS * pixel)))
    )


def _peaks(
    seen: FaceView, lines: Sequence[FaceLine], shifts: FloatArray, pixel: tuple[float, float], reach: float
) -> EdgePeaks:
    """Return the peaks along each line, of all its stretches, from its middle."""
    edges = [edge for line in lines for edge in line.edges]
    count = np.cumsum([0, *(len(line.edges) for line in lines)])
    line_of = np.repeat(np.arange(len(lines)), np.diff(count))
    drawn = np.array([[edge.start, edge.end] for edge in edges])
    outward = np.array([edge.outward for edge in edges])
    run = drawn[:, 1] - drawn[:, 0]
    length = run.sum(axis=1)
    trim = (np.minimum(END_PIXELS * pixel[1], length / 4) / length)[:, None] * run
    shifted = shifts[line_of, None] * outward
    peaks = edge_peaks(
        _gradient(seen, edges[0].horizontal, pixel),
        seen.view.grid,
        drawn[:, 0] + trim + shifted,
        drawn[:, 1] - trim + shifted,
        outward,
        np.full(len(edges), reach),
    )
    middles = np.array([line.whole.middle for line in lines])[line_of]
    offsets = (drawn.mean(axis=1) - middles) @ (run[0] / length[0])
    return join_peaks(peaks, offsets, [range(first, last) for first, last in pairwise(count)])


def _gradient(seen: FaceView, horizontal: bool, pixel: tuple[float, float]) -> Energy:
    sigma = [factor * size / seen.view.grid.resolution for factor, size in zip(SMOOTHING_PIXELS, pixel, strict=True)]
    return gradient_across(seen.view.image, horizontal, *sigma)
