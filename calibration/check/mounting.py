"""Whether a camera still sits as its recording says: by what is plumb, what is level, and what odometry says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from calibration.shelf.bundle import solve
from calibration.shelf.gravity_lines import Tilt, level_direction, level_tilt, vertical_tilt
from calibration.shelf.line_segments import Segments, find_segments
from calibration.shelf.shots import usable_shots
from calibration.shelf.survey import ShelfSurvey, survey_shelf
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording

VERTICALS, LEVELS = "upright edges", "level edges"
"""Names of the methods."""
_MOST_SHOTS = 8
_AROUND = np.radians([0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
_DOWN = -0.1
_YAW_PRIOR = float(np.radians(3.0))
_YAW_AXIS = 2


@dataclass(frozen=True, slots=True, eq=False)
class NamedTilt:
    """What one method says."""

    method: str
    """Its name."""
    tilt: Tilt
    """The tilt of what is seen against the stated mounting."""


@dataclass(frozen=True, slots=True, eq=False)
class MountingCheck:
    """How far a camera is turned against its stated mounting, about the forklift's axes."""

    recording: Recording
    """With the stated mounting."""
    segments: tuple[Segments, ...]
    """Straight edges of the shots, by the stated mounting."""
    tilts: tuple[NamedTilt, ...]
    """One for each method that gave something."""
    turn: FloatArray | None
    """(2,) roll and pitch by which the camera is turned, in radians; None where no method gives them."""
    covariance: FloatArray
    """(2, 2) of these."""
    chance: float
    """How probable such a difference between the methods or a larger one is if both are right."""
    yaw: tuple[float, float] | None
    """Yaw by which it is turned and its standard deviation, in radians; None where nothing tells."""
    survey: ShelfSurvey | None
    """The shelf by the mounting that is corrected for roll and pitch; None where these are not known."""

    @property
    def sigma(self) -> FloatArray:
        """(2,) standard deviations of roll and pitch, in radians."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def corrected(self) -> RigidTransform:
        """Return the mounting with roll and pitch as they were found."""
        turn = np.zeros(2) if self.turn is None else self.turn
        return _turned(self.recording.forklift_from_camera, turn)


def check_mounting(recording: Recording, on_progress: Callable[[str], None] = lambda _: None) -> MountingCheck:
    """Look for a turn of the camera.

    Parameters
    ----------
    recording : Recording
        With the stated mounting, and the nominal plane of the shelf.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    MountingCheck
        Also where nothing was found.
    """
    shots = usable_shots(recording)
    spread = np.unique(np.linspace(0, len(shots) - 1, min(len(shots), _MOST_SHOTS)).round().astype(int))
    on_progress("looking for upright edges")
    segments = [_segments(recording, shots[i]) for i in spread]
    plumb = vertical_tilt(segments) if segments else None
    if plumb is None:
        return MountingCheck(recording, tuple(segments), (), None, np.zeros((2, 2)), 1.0, None, None)
    corrected = _turned(recording.forklift_from_camera, -plumb.turn)
    survey = survey_shelf(
        replace(recording, forklift_from_camera=corrected), recording.shelf, on_progress=on_progress
    )
    tilts = [NamedTilt(VERTICALS, plumb)]
    level = _level(segments, spread, survey, plumb.turn)
    if level is not None:
        tilts.append(NamedTilt(LEVELS, level))
    turn, covariance, chance = _together(tilts)
    yaw = seen_yaw(survey)
    turned_yaw = None if yaw is None else (-yaw[0], yaw[1])
    return MountingCheck(recording, tuple(segments), tuple(tilts), -turn, covariance, chance, turned_yaw, survey)


def _segments(recording: Recording, index: int) -> Segments:
    image = recording.image(recording.shots[index], gray=True)
    ahead = [np.array([np.cos(a), np.sin(a), _DOWN]) for a in _AROUND]
    return find_segments(recording.camera, recording.mounting, image, ahead)


def _turned(forklift_from_camera: RigidTransform, turn: FloatArray) -> RigidTransform:
    """Return a mounting that is turned about the forklift's x and y axes, in its place."""
    rotation = Rotation.from_rotvec([turn[0], turn[1], 0.0]) * forklift_from_camera.rotation
    return RigidTransform.from_components(forklift_from_camera.translation, rotation)


def _level(segments: Sequence[Segments], spread: FloatArray, survey: ShelfSurvey, turn: FloatArray) -> Tilt | None:
    """Return what edges along the shelf say, whose heading the survey knows."""
    plane = survey.plane
    if plane is None:
        return None
    upright = Rotation.from_rotvec([-turn[0], -turn[1], 0.0])
    found = []
    for one, number in zip(segments, spread, strict=True):
        heading = float(plane.yaw - np.pi / 2 - survey.bundle.poses[int(number), 2])
        leveled = replace(one, normals=upright.apply(one.normals), middles=upright.apply(one.middles))
        direction = level_direction(leveled, heading)
        if direction is not None:
            found.append((direction, heading))
    rest = level_tilt(found)
    if rest is None:
        return None
    axis = np.linalg.eigh(rest.information)[1][:, -1]
    return replace(rest, turn=rest.turn + axis * float(axis @ turn))


def _together(tilts: Sequence[NamedTilt]) -> tuple[FloatArray, FloatArray, float]:
    """Return the tilt by all methods, its covariance, and the chance of their differences."""
    information = np.sum([one.tilt.information for one in tilts], axis=0)
    covariance = np.linalg.pinv(information)
    turn = covariance @ np.sum([one.tilt.information @ one.tilt.turn for one in tilts], axis=0)
    off = [one.tilt.turn - turn for one in tilts]
    square = sum(float(rest @ one.tilt.information @ rest) for rest, one in zip(off, tilts, strict=True))
    freedom = len(tilts) - 1
    return turn, covariance, float(chi2.sf(square, freedom)) if freedom else 1.0


def seen_yaw(survey: ShelfSurvey) -> tuple[float, float] | None:
    """Return by how much all is seen turned about the upright axis, and its standard deviation.

    Odometry says in which direction the forklift moves, the landmarks in which the camera does.

    Parameters
    ----------
    survey : ShelfSurvey
        With its landmarks.

    Returns
    -------
    tuple of float or None
        In radians; None where there are no landmarks.
    """
    if not len(survey.bundle.pallets) + len(survey.bundle.edges):
        return None
    places = survey.bundle.edges if survey.observed.edges else None
    bundle = solve(survey.observed, places, _YAW_PRIOR)
    sigma = _YAW_PRIOR * float(np.sqrt(bundle.covariance[_YAW_AXIS, _YAW_AXIS]))
    return bundle.yaw, sigma
