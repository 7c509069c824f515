"""The edges of a face in the shot, each measured to a fraction of a pixel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import median

import numpy as np

from palletloc.edge_fit import EdgeFit
from palletloc.face import EdgeKind, EdgeShift, FaceEdge, edge_shift, face_lines
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.occlusion import Spans, hidden_spans, is_hidden, joined
from palletloc.refinement.profiles import cut_profiles, face_cuts, fit_profiles
from palletloc.shot import MIN_DISTANCE, Shot

SMOOTHING_PX = 1.0
"""Standard deviation of the smoothing along an edge, in pixels of the image."""
FAINT_SMOOTHING_PX = 3.0
"""The same for an edge that is not clearly seen otherwise."""
CLEAR_COVERAGE = 0.5
"""Part of an edge that is seen where it is clear."""
MOST_CLEAR = 0.7
"""Part of the edges that are clear in a good image: there, an edge that is not clear is not there."""
BORDERING = 0.7
"""How much the edge says that parts the face from the pallet's own side, of the same wood in another light."""
LEAST_REACH = 0.75
"""How far an edge is looked for at least, in pixels of the image."""
BELONGS_PX = 0.5
"""How far from its line a peak belongs to it, in pixels of the image."""
FAINT, FAINT_ERROR = 0.1, 0.005
"""Part of the usual gradient below which an edge is faint, and how far such an edge may be off, in metres."""
PIXEL_ERROR = 0.05
"""What an edge's offset is uncertain by beyond its scatter, in pixels of the image."""
NEIGHBOUR_ERROR = 2.0
"""How far a parallel edge in the same place would draw a peak, in pixels of the image."""
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
    """Size of a pixel of the image across the edge, in metres."""
    reach: float
    """How far from its place it was looked for, in metres."""
    evidence_weight: float
    """How much it says whether it is seen, 0 to 1; see `SeenFace.evidence_weight`."""


@dataclass(frozen=True, slots=True)
class SeenFace:
    """A face in the shot and its edges."""

    plane_from_camera: FloatArray
    """(3,) the camera's centre in the face's coordinates: right, up, towards the viewer, in metres."""
    camera_from_face: FloatArray
    """(4, 4) the face's plane in the camera's frame: x right, y up."""
    lines: tuple[FaceEdge, ...]
    """The lines of the face that the camera would see if nothing stood before it, from the first to the last end."""
    edges: tuple[MeasuredEdge, ...]
    """The edges that are seen."""
    expected: float
    """How many edges the camera should see, each as much as it says; without hidden ones."""
    hidden: tuple[tuple[float, float], ...] = ()
    """Stretches of the face that something stands before: (left, right) in metres."""
    hidden_part: float = 0.0
    """Part of the face's width that is hidden, 0 to 1."""

    @property
    def hidden_lines(self) -> tuple[FaceEdge, ...]:
        """The lines that something stands before."""
        return tuple(line for line in self.lines if is_hidden(line, self.hidden))

    def loaded(self, edge: FaceEdge) -> bool:
        """Tell whether a load may begin at an edge: at the upper one, seen from above."""
        return _loaded(self.plane_from_camera, edge)

    def borders_on_side(self, edge: FaceEdge) -> bool:
        """Tell whether the pallet's own side begins at an edge: at the one towards a viewer who stands aside."""
        return _borders_on_side(self.plane_from_camera, edge)

    def evidence_weight(self, edge: FaceEdge) -> float:
        """Return how much it says whether an edge is seen, 0 to 1: less where what borders on it may look alike."""
        return _evidence_weight(self.plane_from_camera, edge)

    def width_px(self, width: float) -> float:
        """Return how wide a face of so many metres is in the image, in pixels; 0 where no upright edge is seen."""
        pixels = [edge.pixel for edge in self.edges if not edge.edge.horizontal]
        return width / float(np.median(pixels)) if pixels else 0.0


@dataclass(frozen=True, slots=True)
class EdgeReach:
    """How far from its place an edge is looked for."""

    level: float
    """Level edges, in metres."""
    upright: float
    """Upright edges, in metres."""
    pixels: float
    """The same in pixels of the image: the larger holds."""
    spacing: float = 1.0
    """About how far cuts across an edge are apart, in pixels of the image."""
    faint: bool = True
    """Whether faint edges are looked for, too."""
    settled: bool = False
    """Whether the face is known to be where it is looked for: then a peak beyond half the way to the next parallel
    line is that line's, and where all lines are missing something stands before them."""


def measure_face(
    shot: Shot, pose: LevelPose, model: PalletModel, reach: EdgeReach, occluders: Spans = ()
) -> SeenFace | Reason:
    """Measure the edges of a face in the shot.

    Parameters
    ----------
    shot : Shot
        The shot.
    pose : LevelPose
        ``forklift_from_pallet`` where the face is looked for.
    model : PalletModel
        The pallet.
    reach : EdgeReach
        How far to look.
    occluders : sequence of (left, right)
        Stretches of the face that something is seen to stand before, in metres.

    Returns
    -------
    SeenFace or Reason
        With the edges of which enough is seen for a line; `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where the
        camera does not see the whole face.
    """
    camera_from_face, plane_from_camera = shot.camera_from_face(pose), shot.camera_in(pose)
    if plane_from_camera[2] < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    right, up = _pixel_sizes(shot, camera_from_face, model)
    if not math.isfinite(right + up):
        return Reason.OUT_OF_VIEW
    below = bool(plane_from_camera[1] < 0)
    # spacings from a ladder: a cut a pixel apart is enough, and the cuts of a model are kept
    cuts = face_cuts(model, reach.spacing * _rung(right), reach.spacing * _rung(up), below)
    pixel = np.where(cuts.level[:, None], [[up, right]], [[right, up]])
    across = pixel[:, 0]
    far = np.maximum(np.where(cuts.level, reach.level, reach.upright), reach.pixels * across)
    gaps = _gaps(model, below)
    if reach.settled:
        far = np.minimum(far, np.maximum(0.5 * np.array(gaps), LEAST_REACH * across))
    center = plane_from_camera.tolist()
    lines = tuple(line.whole for line in cuts.lines)
    weights = [_evidence_weight(center, line) for line in lines]
    shifts = [edge_shift(line, center, model) for line in lines]
    mean = np.array([shift.mean for shift in shifts])
    profiles = cut_profiles(shot, camera_from_face, cuts, mean, far, pixel)
    if not profiles.valid.all():
        return Reason.OUT_OF_VIEW
    peaks, fits = fit_profiles(profiles, SMOOTHING_PX)
    clear = sum(fit is not None and fit.coverage >= CLEAR_COVERAGE for fit in fits)
    if reach.faint and clear < MOST_CLEAR * len(fits):
        peaks, faint = fit_profiles(profiles, FAINT_SMOOTHING_PX)
        fits = [_clearer(*both) for both in zip(fits, faint, strict=True)]
    belongs = np.maximum(BELONGS_PX * across, model.tolerance)
    hidden = joined(hidden_spans(cuts, peaks, fits, belongs), occluders) if reach.settled else joined(occluders)
    usual = median([fit.strength for fit in fits if fit is not None] or [0.0])
    edges = tuple(
        MeasuredEdge(line, fit, _sigma(fit, gap, model.tolerance, size, FAINT * usual), shift, size, away, weight)
        for line, fit, gap, shift, size, away, weight in zip(
            lines, fits, gaps, shifts, across.tolist(), far.tolist(), weights, strict=True
        )
        if fit is not None and not is_hidden(line, hidden)
    )
    expected = sum(weight for line, weight in zip(lines, weights, strict=True) if not is_hidden(line, hidden))
    hidden_part = sum(right - left for left, right in hidden) / model.width
    return SeenFace(plane_from_camera, camera_from_face, lines, edges, expected, hidden, hidden_part)


def _loaded(camera: FloatArray | Sequence[float], edge: FaceEdge) -> bool:
    return edge.kind is EdgeKind.TOP and bool(camera[1] > edge.middle[1])


def _borders_on_side(camera: FloatArray | Sequence[float], edge: FaceEdge) -> bool:
    return edge.kind is EdgeKind.SIDE and bool(camera[0] * edge.outward[0] > abs(edge.middle[0]))


def _evidence_weight(camera: FloatArray | Sequence[float], edge: FaceEdge) -> float:
    if _loaded(camera, edge):
        return 0.0
    return BORDERING if _borders_on_side(camera, edge) else 1.0


def _pixel_sizes(shot: Shot, camera_from_face: FloatArray, model: PalletModel) -> tuple[float, float]:
    """Return the size of a pixel along the face's right and up at its middle, infinite where it is not seen."""
    step = 1e-3
    up = model.height / 2
    points = np.array([[0.0, up], [step, up], [0.0, up + step]])
    pixels, valid = shot.camera.project(points @ camera_from_face[:3, :2].T + camera_from_face[:3, 3])
    if not valid.all():
        return np.inf, np.inf
    at, *ends = pixels.tolist()
    right, up = (step / max(_apart(at, end, shot.camera.period_px), 1e-9) for end in ends)
    return right, up


def _apart(pixel: Sequence[float], other: Sequence[float], period: float | None) -> float:
    """Return the distance of two pixels, the shorter way round where the image is closed."""
    across = other[0] - pixel[0]
    if period is not None:
        across -= period * round(across / period)
    return math.hypot(across, other[1] - pixel[1])


def _rung(size: float) -> float:
    """Return a size rounded to a power of the square root of two."""
    return float(2.0 ** (round(2 * math.log2(size)) / 2))


def _clearer(fine: EdgeFit | None, smooth: EdgeFit | None) -> EdgeFit | None:
    """Return the fit of a faint edge that covers more of it."""
    if fine is None or smooth is None:
        return smooth if fine is None else fine
    return fine if fine.coverage >= min(CLEAR_COVERAGE, smooth.coverage) else smooth


@lru_cache(maxsize=64)
def _gaps(model: PalletModel, without_bottom: bool) -> tuple[float, ...]:
    """Return the distance of each line that is cut from the next parallel one that it may be mistaken for."""
    heights = {line.whole.middle[1] for line in face_lines(model) if line.whole.horizontal}
    return tuple(
        min((abs(line.whole.middle[1] - other) for other in heights - {line.whole.middle[1]}), default=math.inf)
        if line.whole.horizontal
        else math.inf
        for line in face_cuts(model, model.width, model.width, without_bottom).lines
    )


def _sigma(fit: EdgeFit, gap: float, tolerance: float, pixel: float, faint: float) -> float:
    """Return what an edge's offset is uncertain by.

    Edges a few pixels apart draw each other's peaks, and one that is much fainter than the others may be another.
    """
    drawn = pixel * (PIXEL_ERROR + NEIGHBOUR_ERROR * math.exp(-gap / (NEIGHBOUR_PIXELS * pixel)))
    other = FAINT_ERROR * max(0.0, 1 - fit.strength / faint) if faint > 0 else 0.0
    return math.hypot(fit.sigma_offset, tolerance, drawn, other)
