"""The forklift frame in a total station's frame: from points with known places, or from the floor and two wheels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from calibration.findings import Finding, Severity
from palletloc.geometry import FloatArray
from palletloc.survey.bodies import SurveyedBody
from palletloc.survey.faults import check_distances, distance_limit
from palletloc.survey.point import Survey, SurveyPoint
from palletloc.survey.rigid_body import FitError, UncertainPose, fit_rigid, is_mirrored, relative_pose

_CHANCE = 0.001
"""Points contradict each other where chance leaves such a misfit to fewer cases."""
_LINE = 0.02
"""Points narrower than this part of their extent lie on a line: the frame may turn about it."""
_TRACK = (0.3, 5.0)
"""How far apart the marks of two wheels can be, in metres: any vehicle with forks."""
_WHEEL = (-0.05, 1.5)
"""How high a mark on a wheel can be above the floor, in metres."""
_STEEP = np.radians(25.0)
"""No floor leans by more: the axes are swapped, in radians."""
_STEP = 1e-5
"""Step of the derivatives, in metres: far above rounding at a kilometre, far below any curvature."""
_UP = np.array([0.0, 0.0, 1.0])
"""The total station's vertical."""


@dataclass(frozen=True, slots=True, eq=False)
class ForkliftFrame:
    """Where the forklift stood in the survey."""

    method: str
    """How it is known."""
    pose: UncertainPose | None
    """``world_from_forklift`` with its covariance; None where the points do not fix it."""
    findings: tuple[Finding, ...] = ()
    """What is wrong with the points."""
    residuals: Mapping[str, float] | None = None
    """How far each point is from where it should be, in metres."""

    def camera_covariance(self, forklift_from_camera: RigidTransform) -> FloatArray:
        """Return what its errors do to a camera's pose in it, (6, 6), in metres and radians."""
        if self.pose is None:
            return np.full((6, 6), np.inf)
        camera = UncertainPose(self.pose.target_from_source * forklift_from_camera, np.zeros((6, 6)))
        return relative_pose(self.pose, camera).covariance


def frame_from_points(survey: Survey, places: Mapping[str, FloatArray], sigma: float) -> ForkliftFrame:
    """Fit the frame to surveyed points, such as prisms, whose places on the forklift are known.

    Parameters
    ----------
    survey : Survey
        The points.
    places : mapping of str to (3,) array
        In the forklift frame, in metres, by name.
    sigma : float
        Standard deviation of each difference between the two, in metres.

    Raises
    ------
    SurveyError
        If a point is not in the survey, or distances between the points differ from those on the forklift.
    """
    points = [survey.require(name) for name in places]
    body, world = np.array(list(places.values())), np.array([point.position for point in points])
    fault = _spread_fault(body if len(body) else np.zeros((0, 3)), "points on the forklift")
    if fault is not None:
        return ForkliftFrame("measured_points", None, (fault,))
    check_distances(survey, [SurveyedBody("forklift", None, body, tuple(points))], sigma)
    how = "check the order and the signs of the coordinates: right-handed, z up"
    if is_mirrored(body, world, distance_limit(sigma)):
        what = f"{survey.path}: the points on the forklift fit only when mirrored: the survey's axes are left-handed"
        return ForkliftFrame("measured_points", None, (Finding(Severity.FAIL, "mirrored_axes", what, how),))
    try:
        fit = fit_rigid(body, world, sigma)
    except FitError as error:
        what = f"the points on the forklift do not fix its frame: {error}"
        return ForkliftFrame("measured_points", None, (_degenerate(what),))
    if fit.pose.tilt > _STEEP:
        what = f"by its points the forklift is tilted by {np.degrees(fit.pose.tilt):.0f} degrees in the survey"
        fault = Finding(Severity.FAIL, "mirrored_axes", f"{what}: axes are mirrored or swapped, or names are", how)
        return ForkliftFrame("measured_points", None, (fault,))
    off = np.linalg.norm(fit.residuals, axis=1)
    residuals = dict(zip(places, off.tolist(), strict=True))
    return ForkliftFrame("measured_points", fit.pose, _agreement(points, fit.chi2, fit.freedom, off), residuals)


def frame_from_wheels(
    survey: Survey,
    floor: Sequence[str],
    wheels: tuple[str, str],
    sigma: float,
    floor_sigma: float,
    ahead: str | None = None,
) -> ForkliftFrame:
    """Define the frame: z is the floor's normal, y points from the right wheel's mark to the left one's.

    The origin is the foot, on the floor, of the middle between the marks.

    Parameters
    ----------
    survey : Survey
        The points, in a frame with z up.
    floor : sequence of str
        Names of three or more points on the floor.
    wheels : tuple of str
        Names of the marks on the left and the right wheel of one axle, at its ends.
    sigma : float
        Standard deviation of each surveyed coordinate, in metres.
    floor_sigma : float
        How flat the floor is: standard deviation of its height, in metres.
    ahead : str, optional
        Name of a point before the axle, which tells swapped wheels.

    Raises
    ------
    SurveyError
        If a point is not in the survey.
    """
    points = [survey.require(name) for name in (*floor, *wheels)]
    front = None if ahead is None else survey.require(ahead).position
    world = np.array([point.position for point in points])
    fault = _spread_fault(world[:-2], "points on the floor") or _wheel_fault(world, wheels, front)
    if fault is not None:
        return ForkliftFrame("wheel_marks", None, (fault,))
    center, axes = _wheel_frame(world)
    spread = np.full(world.shape, sigma)
    height = float(np.hypot(sigma, floor_sigma))
    spread[:-2] = height
    pose = RigidTransform.from_components(center, Rotation.from_matrix(axes))
    covariance = _propagated(_wheel_frame, world, spread)
    off = np.abs((world[:-2] - center) @ axes[:, 2])
    found = _agreement(points[:-2], float((off**2).sum()) / height**2, len(floor) - 3, off)
    residuals = dict(zip(floor, off.tolist(), strict=True))
    return ForkliftFrame("wheel_marks", UncertainPose(pose, covariance), found, residuals)


def direct_frame() -> ForkliftFrame:
    """Return the frame of a survey that is in the forklift frame already."""
    return ForkliftFrame("direct", UncertainPose(RigidTransform.identity(), np.zeros((6, 6))))


def _degenerate(what: str) -> Finding:
    how = "survey three or more points that are far apart and not on one line"
    return Finding(Severity.DEGENERATE, "frame_points", what, how)


def _spread_fault(points: FloatArray, words: str) -> Finding | None:
    if len(points) < 3:
        return _degenerate(f"{len(points)} {words} do not fix the forklift frame: expected at least 3")
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if extent[1] < _LINE * extent[0]:
        return _degenerate(f"the {words} lie on one straight line: the forklift frame may turn about it")
    return None


def _agreement(points: Sequence[SurveyPoint], misfit: float, freedom: int, off: FloatArray) -> tuple[Finding, ...]:
    """Return whether the points contradict each other, or could not."""
    if freedom < 1 or len(points) == 3:
        what = "three points fix the forklift frame: a fault in one of them may not show"
        return (Finding(Severity.WARNING, "frame_not_checked", what, "survey a fourth point"),)
    if chi2.sf(misfit, freedom) > _CHANCE:
        return ()
    worst = int(np.argmax(off))
    what = f"{points[worst].place} is {1000 * off[worst]:.1f} mm off from what the other points of its kind say"
    return (Finding(Severity.FAIL, "point_moved", what, "survey it again, or state a larger sigma"),)


def _wheel_fault(world: FloatArray, wheels: tuple[str, str], front: FloatArray | None) -> Finding | None:
    center, axes = _wheel_frame(world)
    left, right = wheels
    how = "check the order and the signs of the coordinates, in metres, z up"
    tilt = np.arccos(np.clip(axes[2, 2], -1, 1))
    if tilt > _STEEP:
        what = f"the floor leans by {np.degrees(tilt):.0f} degrees: the survey's third coordinate is not the height"
        return Finding(Severity.FAIL, "swapped_axes", what, how)
    apart = float(np.linalg.norm(world[-2] - world[-1]))
    if not _TRACK[0] < apart < _TRACK[1]:
        what = f"the marks {left} and {right} are {apart:.3g} m apart, expected a forklift's width"
        return Finding(Severity.FAIL, "units", what, "give all coordinates in metres")
    heights = (world[-2:] - center) @ axes[:, 2]
    for name, height in zip(wheels, heights, strict=True):
        if not _WHEEL[0] < height < _WHEEL[1]:
            what = f"the mark {name} is {height:.2f} m above the floor, expected the height of a wheel"
            return Finding(Severity.FAIL, "wheel_height", what, how)
    if front is not None and (front - center) @ axes[:, 0] < 0:
        what = f"the point that is ahead lies behind the axle: are {left} and {right} swapped, or axes mirrored?"
        return Finding(Severity.FAIL, "wheels_swapped", what, "left and right are seen from the driver's seat")
    return None


def _wheel_frame(world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return origin and axes, (3,) and (3, 3), from floor points followed by the left and the right mark."""
    floor, (left, right) = world[:-2], world[-2:]
    middle = floor.mean(0)
    up = np.linalg.svd(floor - middle)[2][2]
    up = up if up @ _UP >= 0 else -up
    across = left - right
    across = across - (across @ up) * up
    y = across / np.linalg.norm(across)
    center = (left + right) / 2
    return center - ((center - middle) @ up) * up, np.stack([np.cross(y, up), y, up], axis=1)


def _propagated(
    frame: Callable[[FloatArray], tuple[FloatArray, FloatArray]], world: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return the covariance of a frame, (6, 6), from independent errors of the points' coordinates."""
    _, axes = frame(world)
    columns = []
    for index in np.ndindex(world.shape):
        step = np.zeros(world.shape)
        step[index] = _STEP
        (after, turned), (before, back) = frame(world + step), frame(world - step)
        rotation = Rotation.from_matrix(turned @ axes.T).as_rotvec() - Rotation.from_matrix(back @ axes.T).as_rotvec()
        columns.append(np.concatenate([after - before, rotation]) / (2 * _STEP) * sigma[index])
    jacobian = np.stack(columns, axis=1)
    return np.asarray(jacobian @ jacobian.T)
