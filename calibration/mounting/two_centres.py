"""Whether a 360-degree camera has one optical centre: it is two lenses, some centimetres apart.

With targets on one side only, the distance of the lenses cannot show; the pose is then that of one lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.findings import Finding, Severity
from calibration.mounting.fit import MountingFit, extra_parameter, fit_mounting, refit
from calibration.mounting.problem import MountingProblem, Poses
from palletloc.cameras.protocol import CameraModel

LENS_AXIS = np.array([1.0, 0.0, 0.0])
"""The front lens looks at the middle of a stitched image: along the camera's x axis."""
_BAND = np.radians(5.0)
"""Corners nearer to the seam may be seen by either lens, in radians."""
LEAST_DISTANCE = 0.003
"""Lens centres nearer to each other than this do no harm, in metres."""
_SIGMAS = 4.0
"""A distance counts from so many standard deviations on: wide, for it fails the calibration."""
_USEFUL = 0.005
"""A distance that is known worse does not tell one lens from two, in metres."""
_FEW = 0.1
"""Share of the corners below which one lens alone decides."""
_ROUNDS = 3
"""Steps by which the distance is found; a lens centre is nearly linear in the equations."""


@dataclass(frozen=True, slots=True)
class TwoCentres:
    """The distance between two lens centres along the camera's x axis, if there were two."""

    distance: float
    """In metres."""
    sigma: float
    """Its standard deviation, in metres; infinite where the targets do not tell."""
    front_share: float
    """Share of the corners that the front lens sees."""

    @property
    def significant(self) -> bool:
        """Whether one centre contradicts the observations."""
        return abs(self.distance) > max(_SIGMAS * self.sigma, LEAST_DISTANCE)


def lens_distance(solution: MountingFit, camera: CameraModel) -> TwoCentres | None:
    """Return the distance of the lenses that the observations tell.

    Parameters
    ----------
    solution : MountingFit
        With one centre.
    camera : CameraModel
        Of the shots.

    Returns
    -------
    TwoCentres, optional
        None for a camera that is not a stitched panorama.
    """
    if camera.period_px is None:
        return None
    sides = np.concatenate([corners.bearings for corners in solution.problem.observations]) @ LENS_AXIS
    front = float((sides > 0).mean())
    clear = refit(solution, _beside_seam(solution.problem))
    column = clear.problem.by_lens_distance(clear.poses, LENS_AXIS)
    value, sigma = extra_parameter(clear, column)
    return TwoCentres(value, sigma, front)


def fit_two_centres(problem: MountingProblem, start: Poses) -> tuple[MountingFit, float]:
    """Fit camera and targets with two lens centres along the camera's x axis.

    Parameters
    ----------
    problem : MountingProblem
        The observations, as from one centre.
    start : Poses
        Rough values.

    Returns
    -------
    solution : MountingFit
        With two centres.
    distance : float
        Between them, in metres.
    """
    distance, problem = 0.0, _beside_seam(problem)
    solution = fit_mounting(problem, start)
    for _ in range(_ROUNDS):
        step, _ = extra_parameter(solution, solution.problem.by_lens_distance(solution.poses, LENS_AXIS))
        distance += step
        solution = fit_mounting(problem.with_lens_distance(distance, LENS_AXIS), solution.poses)
    return solution, distance


def _beside_seam(problem: MountingProblem) -> MountingProblem:
    """Return the problem without corners near the seam, where it is open which of the lenses sees them."""
    return problem.kept([np.abs(corners.bearings @ LENS_AXIS) > np.sin(_BAND) for corners in problem.observations])


def apart(distance: float) -> Finding:
    """Return the finding that the lens centres are this far apart, in metres."""
    what = f"the two lenses' centres are {1000 * distance:.1f} mm apart: one centre does not describe this camera"
    how = "use the raw shots with the camera model dual_fisheye, or targets on the shelf's side only"
    return Finding(Severity.FAIL, "two_centres", what, how)


def lens_finding(centres: TwoCentres) -> Finding | None:
    """Return what the test means for the use of the result, or None where one centre is confirmed."""
    if min(centres.front_share, 1 - centres.front_share) < _FEW:
        side = "front (+x)" if centres.front_share > 0.5 else "back (-x)"
        what = f"nearly all targets are on the {side} side of the camera: the result is valid only for this lens side"
        return Finding(Severity.WARNING, "one_lens_side", what, "hang targets before and behind the camera")
    if centres.significant:
        return apart(centres.distance)
    if centres.sigma > _USEFUL:
        what = f"the targets tell the distance of the lens centres only to {1000 * centres.sigma:.0f} mm"
        return Finding(
            Severity.WARNING, "two_centres_unknown", what, "hang targets closer, before and behind the camera"
        )
    return None
