"""Position and yaw from the edges of the front face, to a fraction of a pixel, with their covariance.

Each edge is measured across itself on a view of the face where the sweep found it. One linear least-squares fit
explains the offsets by a small motion of the face; what is known of height and yaw enters as observations, what
is not known of the mounting as parameters with their own sigmas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.edge_fit import TUKEY, EdgeFit, edge_peaks, fit_edge
from palletloc.face import EdgeKind, FaceEdge, edge_shift, face_edges
from palletloc.geometry import FloatArray, Image, LevelPose, wrap_angle
from palletloc.matching import gradient_across
from palletloc.measurement import HeightPrior, Reason
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.pixel_size import pixel_sizes
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView
from palletloc.projection import Interpolation, Projector

END_PIXELS = 1.0
"""How many pixels of the camera's image at each end of an edge are left out."""
SMOOTHING_PIXELS = np.array([0.6, 1.0])
"""Smoothing before the gradient across and along an edge, in pixels of the camera's image."""

PIXEL_ERROR = 0.06
"""What an edge's offset is uncertain by beyond its scatter, in pixels of the camera's image."""


@dataclass(frozen=True, slots=True)
class FaceFitConfig:
    """How the edges of the face are measured and combined."""

    resolution: float = 0.003
    """Metres per pixel of the view of the face."""
    reach: float = 0.011
    """How far from its place an edge is looked for, in metres."""
    reach_px: float = 1.5
    """The same in pixels of the camera's image: the larger holds."""
    first_reach: float = 0.03
    """How far upright edges, which have no neighbours, are looked for at first, in metres."""
    iterations: int = 5
    """Most views of the face, each placed where the last fit says."""
    min_coverage: float = 0.3
    """Least part of an edge that must be seen for it to count."""
    min_edges: int = 5
    """Fewest edges that must be seen."""
    slope_error_px: float = 0.15
    """How far each end of a level edge may lie off where its slope gives the yaw, in pixels of the camera's image."""


@dataclass(frozen=True, slots=True)
class YawPrior:
    """The yaw as the horizontal plane gives it."""

    sigma: float
    """Standard deviation of the start's yaw, in radians."""
    up: float
    """Height on the face of the edge that gave it, in metres."""


@dataclass(frozen=True, slots=True)
class MeasuredEdge:
    """One edge of the face and what was measured of it."""

    edge: FaceEdge
    """The edge."""
    fit: EdgeFit
    """Its offset and slope on the face, against the drawn edge."""
    sigma: float
    """Standard deviation of the offset with everything that is not known of the edge, in metres."""
    expected: float
    """Expected offset: the shift of a rounded edge, in metres."""
    pixel: float
    """Size of a pixel of the camera's image across the edge, in metres."""


@dataclass(frozen=True, slots=True)
class FaceEstimate:
    """The pose of a face from its edges."""

    forklift_from_pallet: LevelPose
    """The pose."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    edges: tuple[MeasuredEdge, ...]
    """The edges that were seen, as the last view shows them."""
    weights: FloatArray
    """Weight of each edge in the robust fit, 0 to 1."""
    coverage: float
    """Part of the face's edges that lies where the pose says, 0 to 1, by length."""
    chi2: float
    """Mean squared normalised residual of the edges that count."""
    view: PlaneView
    """The face as it was last viewed."""


def fit_face(
    projector: Projector,
    image: Image,
    mounting: Mounting,
    start: LevelPose,
    model: PalletModel,
    height: HeightPrior,
    yaw: YawPrior | None,
    yaw_spread: float,
    config: FaceFitConfig,
) -> FaceEstimate | Reason:
    """Fit the pose of a face to its edges.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    mounting : Mounting
        Of the camera.
    start : LevelPose
        ``forklift_from_pallet``, right to some millimetres where edges are.
    model : PalletModel
        The pallet.
    height : HeightPrior
        Of the face's lower edge.
    yaw : YawPrior or None
        What the horizontal plane says; None where the slopes of the face's level edges have to give the yaw.
    yaw_spread : float
        Standard deviation of the start's yaw where ``yaw`` is None, in radians.
    config : FaceFitConfig
        Parameters.

    Returns
    -------
    FaceEstimate or Reason
        `Reason.FEW_EDGES` where too little of the face is seen.
    """
    camera_from_forklift = mounting.forklift_from_camera.inv()
    pose, estimate = start, None
    for i in range(config.iterations):
        reach = max(config.reach, config.first_reach / 2**i)
        seen = _measure(projector, image, camera_from_forklift, pose, model, reach, config)
        if isinstance(seen, Reason):
            return seen
        view, camera, edges = seen
        if len(edges) < config.min_edges:
            return Reason.FEW_EDGES
        system = _System(camera, pose, mounting)
        system.add_offsets(edges)
        system.add_height(pose, height)
        if yaw is not None:
            system.add_yaw(yaw, wrap_angle(pose.yaw - start.yaw))
        else:
            system.add_slopes(edges, config)
            system.add_spread(wrap_angle(pose.yaw - start.yaw), yaw_spread)
        motion, covariance, weights, chi2 = system.solve(len(edges))
        moved = _moved(pose, motion)
        estimate = FaceEstimate(
            moved, _in_forklift(covariance, pose.yaw), tuple(edges), weights, _coverage(model, edges, weights), chi2, view
        )
        step = np.abs(motion[:3]).max()
        pose = moved
        if step < 0.001 and abs(motion[3]) < 0.001 and reach <= config.reach:
            break
    return Reason.FEW_EDGES if estimate is None else estimate


def _measure(
    projector: Projector,
    image: Image,
    camera_from_forklift: RigidTransform,
    pose: LevelPose,
    model: PalletModel,
    upright_reach: float,
    config: FaceFitConfig,
) -> tuple[PlaneView, FloatArray, list[MeasuredEdge]] | Reason:
    camera_from_plane = camera_from_forklift * pose.transform() * PALLET_FROM_VERTICAL
    camera = np.asarray(camera_from_plane.inv().translation)
    if camera[2] < 0.2:
        return Reason.BEHIND_FACE
    half = model.width / 2 + 0.06
    grid = PlaneGrid.spanning(-half, half, -0.06, model.height + 0.06, config.resolution)
    view = projector.view(image, camera_from_plane, grid, Interpolation.CUBIC)
    if not view.valid.all():
        return Reason.OUT_OF_VIEW
    directions = np.array([[1.0, 0.0], [0.0, 1.0]])
    pixel = pixel_sizes(projector.camera, camera_from_plane, np.full((2, 2), [0.0, model.height / 2]), directions)
    across, along = SMOOTHING_PIXELS / config.resolution
    level = gradient_across(view.image, True, float(across * pixel[1]), float(along * pixel[0]))
    upright = gradient_across(view.image, False, float(across * pixel[0]), float(along * pixel[1]))
    edges = []
    for edge in face_edges(model):
        if edge.kind is EdgeKind.BOTTOM and camera[1] < 0:
            continue  # a beam hides it, and its edge would be taken for the pallet's
        gradient, size = (level, pixel[::-1]) if edge.horizontal else (upright, pixel)
        reach = config.reach if edge.horizontal else upright_reach
        reach = max(reach, config.reach_px * float(size[0]))
        measured = _measure_edge(gradient, grid, edge, camera, model, size, reach)
        if measured is not None and measured.fit.coverage >= config.min_coverage:
            edges.append(measured)
    return view, camera, edges


def _measure_edge(
    gradient: FloatArray,
    grid: PlaneGrid,
    edge: FaceEdge,
    camera: FloatArray,
    model: PalletModel,
    pixel: FloatArray,
    reach: float,
) -> MeasuredEdge | None:
    """Measure one edge; ``pixel`` holds the sizes of the camera's pixels across and along it."""
    shift = edge_shift(edge, camera, model)
    across, along = float(pixel[0]), float(pixel[1])
    trim = min(END_PIXELS * along, edge.length / 4) / edge.length
    ends = np.array([edge.start, edge.end])
    ends = ends + trim * np.array([ends[1] - ends[0], ends[0] - ends[1]]) + shift.mean * np.array(edge.outward)
    peaks = edge_peaks(gradient, grid, tuple(ends[0]), tuple(ends[1]), edge.outward, reach)
    # an upright edge stays upright: only level ones may tilt, by the yaw
    tilt = np.inf if edge.horizontal else 0.5 * across / edge.length
    fit = fit_edge(peaks, across, along, slope_sigma=tilt)
    if fit is None:
        return None
    sigma = float(np.sqrt(fit.sigma_offset**2 + shift.sigma**2 + (PIXEL_ERROR * across) ** 2))
    return MeasuredEdge(edge, fit, sigma, shift.mean, across)


class _System:
    """Rows of the linear least squares in (right, up, depth, yaw) and six parameters of the mounting."""

    def __init__(self, camera: FloatArray, pose: LevelPose, mounting: Mounting) -> None:
        self.camera = camera
        self.mounting = mounting
        self.forklift_from_plane = pose.transform() * PALLET_FROM_VERTICAL
        self.rows: list[FloatArray] = [row / sigma for row, sigma in zip(np.eye(10)[4:], mounting.sigma, strict=True)]
        self.values: list[float] = [0.0] * 6
        self.robust: list[bool] = [False] * 6

    def _add(self, row: FloatArray, value: float, sigma: float, robust: bool = False) -> None:
        self.rows.append(row / sigma)
        self.values.append(value / sigma)
        self.robust.append(robust)

    def _motion(self, right: float, up: float) -> FloatArray:
        """Return the derivative of a face point's image on the plane, (2, 10)."""
        point = self.forklift_from_plane.apply([right, up, 0.0])
        into_plane = self.forklift_from_plane.rotation.as_matrix().T
        apparent = into_plane @ self.mounting.apparent_motion(np.asarray(point))
        moved = np.zeros((3, 10))
        moved[0, 0] = moved[1, 1] = 1.0
        moved[2, 2], moved[2, 3] = -1.0, -right  # deeper is away from the viewer
        moved[:, 4:] = apparent
        # a point that comes nearer moves away from the camera's foot
        ray = np.array([right - self.camera[0], up - self.camera[1]]) / self.camera[2]
        return np.asarray(moved[:2] + ray[:, None] * moved[2])

    def _slope(self, up: float) -> FloatArray:
        """Return the derivative of a level line's slope on the plane, (10,)."""
        return np.asarray(self._motion(0.5, up)[1] - self._motion(-0.5, up)[1])

    def add_offsets(self, edges: Sequence[MeasuredEdge]) -> None:
        """Add one row for each edge: its offset at the middle."""
        for one in edges:
            row = np.array(one.edge.outward) @ self._motion(*one.edge.middle)
            self._add(row, one.fit.offset, one.sigma, robust=True)

    def add_slopes(self, edges: Sequence[MeasuredEdge], config: FaceFitConfig) -> None:
        """Add one row for each level edge: its slope."""
        for one in edges:
            if one.edge.horizontal:
                error = np.sqrt(2.0) * config.slope_error_px * one.pixel / one.edge.length
                sigma = float(np.hypot(one.fit.sigma_slope, error))
                self._add(one.edge.outward[1] * self._slope(one.edge.middle[1]), one.fit.slope, sigma, robust=True)

    def add_height(self, pose: LevelPose, height: HeightPrior) -> None:
        """Add what is known of the height."""
        self._add(np.eye(10)[1], height.z - pose.z, height.sigma)

    def add_yaw(self, yaw: YawPrior, turned: float) -> None:
        """Add the horizontal plane's yaw, which a tilt of the camera falsifies as it does a line on the face."""
        slope = self._slope(yaw.up)
        self._add(slope / slope[3], -turned, yaw.sigma)

    def add_spread(self, turned: float, sigma: float) -> None:
        """Add what is known of the yaw without any measurement."""
        self._add(np.eye(10)[3], -turned, sigma)

    def solve(self, edges: int) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return motion (4,), covariance (4, 4), weights of the edges and their mean squared residual."""
        rows, values, robust = np.array(self.rows), np.array(self.values), np.array(self.robust)
        weights = np.ones(len(values))
        for _ in range(15):
            normal = rows.T @ (weights[:, None] * rows)
            solution = np.linalg.solve(normal, rows.T @ (weights * values))
            residual = values - rows @ solution
            spread = max(1.0, 1.4826 * float(np.median(np.abs(residual[robust]))))
            update = np.where(robust, np.clip(1 - (residual / (TUKEY * spread)) ** 2, 0, None) ** 2, 1.0)
            if np.abs(update - weights).max() < 1e-3:
                break
            weights = update
        used = robust & (weights > 0.2)
        chi2 = float((weights * residual**2)[used].sum() / max(weights[used].sum(), 1.0))
        covariance = np.linalg.inv(normal)[:4, :4] * max(chi2, 1.0)
        first = int(np.flatnonzero(robust)[0])
        return solution[:4], covariance, weights[first : first + edges], chi2


def _moved(pose: LevelPose, motion: FloatArray) -> LevelPose:
    right, up, depth, turn = motion
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    return LevelPose(
        float(pose.x + cos * depth + sin * right),
        float(pose.y + sin * depth - cos * right),
        float(pose.z + up),
        wrap_angle(float(pose.yaw + turn)),
    )


def _in_forklift(covariance: FloatArray, yaw: float) -> FloatArray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[sin, 0, cos, 0], [-cos, 0, sin, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return np.asarray(turn @ covariance @ turn.T)


def _coverage(model: PalletModel, edges: Sequence[MeasuredEdge], weights: FloatArray) -> float:
    total = sum(edge.length for edge in face_edges(model))
    seen = sum(
        one.edge.length * one.fit.coverage for one, weight in zip(edges, weights, strict=True) if weight > 0.2
    )
    return float(seen / total)
