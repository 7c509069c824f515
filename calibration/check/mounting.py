"""Whether a camera still sits as its recording says: by what is plumb, what is level, and what odometry says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.check import tilt_sources
from calibration.check.floor_lines import floor_segments, floor_tilt
from calibration.check.pallet_heights import HeightEstimate, height_estimate, measure_elevations
from calibration.drive import evenly_spread
from calibration.shelf.gravity_lines import Tilt, level_direction, level_tilt, vertical_tilt
from calibration.shelf.landmarks import usable_shots
from calibration.shelf.line_segments import Segments, find_segments
from calibration.shelf.problem import solve
from calibration.shelf.survey import ShelfSurvey, survey_shelf
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording

_MOST_SHOTS = 8
"""Shots whose edges are looked for: more take time and show the same edges."""
_AROUND = np.radians([0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
"""Where patches look for upright edges, in radians: 60 degrees each, all around."""
_DOWN = -0.1
"""Height of their direction: uprights reach farther below the camera than above."""
_FLOOR_AROUND = np.radians([0.0, 90.0, 180.0, 270.0])
"""Where patches look for lines on the floor, in radians: 45 degrees down, four are enough."""
_FLOOR_DOWN = -1.0
"""Height of their direction."""
_YAW_PRIOR = float(np.radians(3.0))
"""How far the yaw may be off, one standard deviation, in radians: what a bent bracket does."""
_YAW_AXIS = 2
"""Its place among the unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class NamedYaw:
    """What one source says of the yaw."""

    method: str
    """Its name."""
    turn: float
    """Yaw by which the camera is turned, in radians."""
    sigma: float
    """Its standard deviation, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class MountingCheck:
    """How far a camera is turned against its stated mounting, about the forklift's axes."""

    recording: Recording
    """With the stated mounting."""
    segments: tuple[Segments, ...]
    """Straight edges of the shots, by the stated mounting."""
    tilts: tuple[tilt_sources.NamedTilt, ...]
    """One for each source that gave something."""
    turn: FloatArray | None
    """(2,) roll and pitch by which the camera is turned, in radians; None where no source gives them."""
    covariance: FloatArray
    """(2, 2) of these."""
    chance: float
    """How probable such differences between the sources or larger ones are if all are right."""
    yaw: tuple[float, float] | None
    """Yaw by which it is turned and its standard deviation, in radians; None where nothing tells."""
    survey: ShelfSurvey | None
    """The shelf by the mounting that is corrected for roll and pitch; None where there are no shots."""
    absent: tuple[tilt_sources.Absent, ...] = ()
    """Sources that say nothing of roll and pitch."""
    worst: tilt_sources.Contradiction | None = None
    """The two sources that differ most for what they state."""
    yaws: tuple[NamedYaw, ...] = ()
    """What pallets alone and uprights alone say of the yaw."""
    height: tuple[float, float] | None = None
    """How much higher the camera is than stated and the standard deviation, in metres; None where nothing tells."""

    @property
    def sigma(self) -> FloatArray:
        """(2,) standard deviations of roll and pitch, in radians."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def corrected(self) -> RigidTransform:
        """Return the mounting with roll and pitch as they were found."""
        turn = np.zeros(2) if self.turn is None else self.turn
        return _turned(self.recording.forklift_from_camera, turn)


def measure_turn(recording: Recording, on_progress: Callable[[str], None] = lambda _: None) -> MountingCheck:
    """Look for a turn of the camera against the mounting that a recording states, by its nominal shelf plane."""
    shots = usable_shots(recording)
    if not shots:
        return MountingCheck(recording, (), (), None, np.zeros((2, 2)), 1.0, None, None)
    spread = [int(i) for i in evenly_spread(len(shots), _MOST_SHOTS)]
    on_progress("looking for upright edges")
    segments = [_segments(recording, shots[i]) for i in spread]
    plumb = vertical_tilt(segments)
    start = np.zeros(2) if plumb is None else plumb.turn
    corrected = _turned(recording.forklift_from_camera, -start)
    survey = survey_shelf(
        replace(recording, forklift_from_camera=corrected), recording.shelf, on_progress=on_progress
    )
    on_progress("comparing the heights of pallets")
    heights = measure_elevations(survey)
    estimate = None if heights is None else height_estimate(heights, float(corrected.translation[2]))
    on_progress("looking for lines on the floor")
    rest = {
        tilt_sources.LEVELS: _level(segments, spread, survey, start),
        tilt_sources.FLOOR: _floor(survey, spread),
        tilt_sources.PALLETS: None if estimate is None else estimate.tilt,
    }
    # These were measured after the upright edges had been made plumb: against the stated mounting that comes on top.
    tilts = [] if plumb is None else [tilt_sources.NamedTilt(tilt_sources.VERTICALS, plumb)]
    tilts += [tilt_sources.NamedTilt(name, _on_top(tilt, start)) for name, tilt in rest.items() if tilt is not None]
    told = {source.method for source in tilts}
    absent = tuple(tilt_sources.Absent(name, why) for name, why in _WHY.items() if name not in told)
    yaw, yaws = _yaws(survey)
    if not tilts:
        return MountingCheck(recording, tuple(segments), (), None, np.zeros((2, 2)), 1.0, yaw, survey, absent)
    fused = tilt_sources.fused_tilt(tilts)
    return MountingCheck(
        recording, tuple(segments), tuple(tilts), -fused.turn, fused.covariance, fused.chance, yaw, survey, absent,
        fused.worst, yaws, _height(estimate, fused.turn - start, fused.covariance),
    )  # fmt: skip


_WHY = {
    tilt_sources.VERTICALS: "fewer than eight upright edges are seen",
    tilt_sources.LEVELS: "too few level edges along the shelf are seen, or its heading is not known",
    tilt_sources.FLOOR: "no line on the floor, along the shelf or square to it, is seen in three shots",
    tilt_sources.PALLETS: "fewer than six sights of pallets",
}
"""Why a source says nothing."""


def _height(estimate: HeightEstimate | None, turn: FloatArray, covariance: FloatArray) -> tuple[float, float] | None:
    return None if estimate is None else estimate.height_given(turn, covariance)


def _on_top(tilt: Tilt, turn: FloatArray) -> Tilt:
    """Return a tilt that comes on top of a turn, about the axes that it speaks of."""
    values, axes = np.linalg.eigh(tilt.information)
    known = axes[:, values > 1e-6 * values.max()]
    return replace(tilt, turn=tilt.turn + known @ (known.T @ turn))


def _segments(recording: Recording, index: int) -> Segments:
    image = recording.image(recording.shots[index], gray=True)
    ahead = [np.array([np.cos(a), np.sin(a), _DOWN]) for a in _AROUND]
    return find_segments(recording.camera, recording.mounting, image, ahead)


def _floor(survey: ShelfSurvey, spread: Sequence[int]) -> Tilt | None:
    """Return what lines on the floor say, by the mounting that the survey has."""
    recording = survey.recording
    if survey.plane is None:
        return None
    ahead = [np.array([np.cos(a), np.sin(a), _FLOOR_DOWN]) for a in _FLOOR_AROUND]
    ahead += [np.array([np.cos(a), np.sin(a), _DOWN]) for a in _AROUND]
    found = []
    for i in spread:
        image = recording.image(recording.shots[survey.shots[i]], gray=True)
        found.append(find_segments(recording.camera, recording.mounting, image, ahead))
    poses = survey.solution.poses[list(spread)]
    return floor_tilt(floor_segments(found, poses, recording.mounting.center, survey.plane))


def _turned(forklift_from_camera: RigidTransform, turn: FloatArray) -> RigidTransform:
    """Return a mounting that is turned about the forklift's x and y axes, in its place."""
    rotation = Rotation.from_rotvec([turn[0], turn[1], 0.0]) * forklift_from_camera.rotation
    return RigidTransform.from_components(forklift_from_camera.translation, rotation)


def _level(segments: Sequence[Segments], spread: Sequence[int], survey: ShelfSurvey, turn: FloatArray) -> Tilt | None:
    """Return what edges along the shelf say, whose heading the survey knows, once upright edges are plumb."""
    plane = survey.plane
    if plane is None:
        return None
    upright = Rotation.from_rotvec([-turn[0], -turn[1], 0.0])
    found = []
    for edges, number in zip(segments, spread, strict=True):
        heading = float(plane.yaw - np.pi / 2 - survey.solution.poses[int(number), 2])
        leveled = replace(edges, normals=upright.apply(edges.normals), middles=upright.apply(edges.middles))
        direction = level_direction(leveled, heading)
        if direction is not None:
            found.append((direction, heading))
    return level_tilt(found)


def _yaws(survey: ShelfSurvey) -> tuple[tuple[float, float] | None, tuple[NamedYaw, ...]]:
    """Return by how much the camera is turned in yaw, by all landmarks and by each kind of them."""
    kinds = {
        tilt_sources.PALLETS: replace(survey.observed, edges=()),
        "uprights": replace(survey.observed, pallets=(), pallet_of=np.zeros(0, np.intp)),
    }
    seen = _seen_yaw(survey)
    yaws = []
    for name, observed in kinds.items():
        turned = _seen_yaw(replace(survey, observed=observed)) if observed.pallets or observed.edges else None
        if turned is not None:
            yaws.append(NamedYaw(name, -turned[0], turned[1]))
    return (None if seen is None else (-seen[0], seen[1])), tuple(yaws)


def _seen_yaw(survey: ShelfSurvey) -> tuple[float, float] | None:
    """Return by how much all is seen turned about the upright axis, and its standard deviation, in radians.

    Odometry says in which direction the forklift moves, the landmarks in which the camera does. None without any.
    """
    if not survey.observed.pallets and not survey.observed.edges:
        return None
    places = survey.solution.edges if survey.observed.edges else None
    solution = solve(survey.observed, places, _YAW_PRIOR)
    sigma = _YAW_PRIOR * float(np.sqrt(solution.covariance[_YAW_AXIS, _YAW_AXIS]))
    return solution.yaw, sigma
