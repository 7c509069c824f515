"""What the heights at which pallets appear over the way say of the camera's turn and height.

A camera that is nose-down sees what is before it too high and what is behind it too low. A pallet does not move while
the forklift passes it, so that it tells even where its own height is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.check.tilt_sources import fit_with_prior
from calibration.drive import evenly_spread, relative
from calibration.shelf.gravity_lines import Tilt
from calibration.shelf.survey import ShelfSurvey
from palletloc.config import LocalizerConfig
from palletloc.geometry import FloatArray, LevelPose
from palletloc.localizer import Localizer, Start

_MOST_SHOTS = 12
"""Shots that are measured once more: more take time."""
_LEAST_SIGHTS = 6
"""Sights at least: there are five unknowns for one pallet."""
_ON_LEVEL = 0.08
"""A pallet nearer to a level stands on it, in metres."""
_LEVEL, _FREE = 0.006, 0.3
"""How well the height of a pallet on a level is known, and of another one, in metres."""
_HEIGHT = 0.02
"""How well the height of the camera is known before, in metres."""
_RANGE = 0.006
"""How well the distance of a pallet is known, in metres."""
_ELEVATION = float(np.radians(0.04))
"""Standard deviation of an elevation at least, in radians: what camera model and floor add."""
_FAINT = 1e-6
"""Information that keeps unknowns of which nothing is told where they are, in per square unit."""


@dataclass(frozen=True, slots=True, eq=False)
class PalletElevations:
    """Pallets as they are seen above and below the horizon; one row for each sight."""

    pallet: FloatArray
    """(n,) which pallet it is, from 0 on."""
    azimuth: FloatArray
    """(n,) from the camera, in the forklift frame, in radians."""
    distance: FloatArray
    """(n,) on the floor from the camera's foot, by all shots and the odometry, in metres."""
    elevation: FloatArray
    """(n,) of the middle of the front's lower edge, in radians."""
    sigma: FloatArray
    """(n,) standard deviation of the elevation, in radians."""
    heights: FloatArray
    """(m,) about how high each pallet stands, in metres."""
    height_sigmas: FloatArray
    """(m,) how well that is known, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class HeightEstimate:
    """What pallets say of roll, pitch and height together."""

    tilt: Tilt
    """The tilt of what is seen, whatever the camera's height."""
    height: float
    """How much higher the camera is than stated, in metres."""
    covariance: FloatArray
    """(3, 3) of the tilt about x and y and of the height."""
    pallets: int
    """How many pallets there are."""

    def height_given(self, turn: FloatArray, covariance: FloatArray) -> tuple[float, float]:
        """Return the height and its standard deviation once the tilt, (2,) in radians, is known better."""
        slope = self.covariance[2, :2] @ np.linalg.inv(self.covariance[:2, :2])
        height = self.height + float(slope @ (turn - self.tilt.turn))
        left = self.covariance[2, 2] - slope @ (self.covariance[:2, :2] - covariance) @ slope
        return height, float(np.sqrt(max(left, 0.0)))


def measure_elevations(survey: ShelfSurvey) -> PalletElevations | None:
    """Measure the pallets of a survey once more, with nothing said of their heights.

    Parameters
    ----------
    survey : ShelfSurvey
        With poses and pallets.

    Returns
    -------
    PalletElevations or None
        None where too few are seen.
    """
    recording, solution = survey.recording, survey.solution
    if not len(solution.pallets):
        return None
    seen = np.array([sight.pose.z for sight in survey.observed.pallets])
    owner = survey.observed.pallet_of
    heights = np.array([float(np.median(seen[owner == i])) for i in range(len(solution.pallets))])
    config = replace(LocalizerConfig(), prior=replace(LocalizerConfig().prior, free_sigma=_FREE))
    localizer = Localizer(recording.models, config=config)
    shots = np.unique([sight.shot for sight in survey.observed.pallets])
    rows: list[tuple[float, ...]] = []
    for number in shots[evenly_spread(len(shots), _MOST_SHOTS)]:
        mine = [i for sight, i in zip(survey.observed.pallets, owner, strict=True) if sight.shot == number]
        mine = list(dict.fromkeys(int(i) for i in mine))
        there = relative(solution.poses[number], solution.pallets[mine])
        starts = [
            Start(survey.models[i].name, LevelPose(float(x), float(y), float(heights[i]), float(yaw)))
            for i, (x, y, yaw) in zip(mine, there, strict=True)
        ]
        shot = recording.shots[survey.shots[int(number)]]
        found = localizer.localize_from(recording.shot(shot), starts)
        for i, place, measurement in zip(mine, there, found, strict=True):
            if measurement is not None and measurement.model == survey.models[i].name:
                rows.append(
                    (
                        i,
                        *_sight(
                            measurement.forklift_from_pallet, measurement.covariance, recording.mounting.center, place
                        ),
                    )
                )
    if len(rows) < _LEAST_SIGHTS:
        return None
    levels = np.array(recording.shelf.levels or (np.inf,))
    near = levels[np.abs(levels - heights[:, None]).argmin(axis=1)]
    known = np.abs(near - heights) < _ON_LEVEL
    sigmas = np.where(known, _LEVEL, _FREE)
    pallet, azimuth, distance, elevation, sigma = np.array(rows).T
    return PalletElevations(pallet, azimuth, distance, elevation, sigma, np.where(known, near, heights), sigmas)


def _sight(
    pose: LevelPose, covariance: FloatArray, center: FloatArray, place: FloatArray
) -> tuple[float, float, float, float]:
    """Return azimuth, known distance, elevation and its standard deviation.

    The elevation does not mind that the shot alone tells the distance badly.
    """
    x, y, z = np.array([pose.x, pose.y, pose.z]) - center
    across = float(np.hypot(x, y))
    slope = np.array([-z * x / across, -z * y / across, across]) / (across**2 + z**2)
    sigma = float(np.sqrt(slope @ covariance[:3, :3] @ slope))
    distance = float(np.hypot(*(place[:2] - center[:2])))
    return float(np.arctan2(y, x)), distance, float(np.arctan2(z, across)), float(np.hypot(sigma, _ELEVATION))


def height_estimate(sights: PalletElevations, camera_height: float) -> HeightEstimate | None:
    """Return the tilt and the height of the camera that explain at which elevations pallets are seen.

    Parameters
    ----------
    sights : PalletElevations
        What was seen.
    camera_height : float
        As stated, in metres.

    Returns
    -------
    HeightEstimate or None
        None where there are too few sights.

    Notes
    -----
    Unknown beside them are the height of each pallet and what all its distances have wrong alike. With a tilt w of
    what is seen, the elevation at azimuth phi grows by w_x sin(phi) - w_y cos(phi).
    """
    pallets = len(sights.heights)
    if len(sights.elevation) < _LEAST_SIGHTS:
        return None
    index = sights.pallet.astype(np.intp)
    deep = sights.heights[index] - camera_height
    square = sights.distance**2 + deep**2
    design = np.zeros((len(index), 3 + 2 * pallets))
    design[:, 0], design[:, 1] = np.sin(sights.azimuth), -np.cos(sights.azimuth)
    design[:, 2] = -sights.distance / square
    rows = np.arange(len(index))
    design[rows, 3 + index] = sights.distance / square
    design[rows, 3 + pallets + index] = -deep / square
    away = sights.elevation - np.arctan2(deep, sights.distance)
    priors = np.concatenate([[0.0, 0.0, _HEIGHT**-2], sights.height_sigmas**-2, np.full(pallets, _RANGE**-2)])
    solution, told = fit_with_prior(design, away, sights.sigma, np.diag(priors + _FAINT))
    covariance = np.asarray(np.linalg.inv(told))
    information = np.linalg.inv(covariance[:2, :2])
    tilt = Tilt(solution[:2], np.asarray(information), len(index))
    return HeightEstimate(tilt, float(solution[2]), covariance[:3, :3], len(np.unique(index)))
