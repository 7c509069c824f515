"""Whether a 360-degree camera has one optical centre: it is two lenses, some centimetres apart.

With targets on one side only, the distance of the lenses cannot show; the pose is then that of one lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.extrinsics import Extrinsics, extra_parameter, resolve, solve
from calibration.findings import Finding, Severity
from calibration.network import Network, Poses
from palletloc.cameras.protocol import CameraModel

_AXIS = np.array([1.0, 0.0, 0.0])  # the front lens looks at the middle of a stitched image
_BAND = np.radians(5.0)
LEAST_DISTANCE = 0.003
"""Lens centres nearer to each other than this do no harm, in metres."""
_SIGMAS, _USEFUL = 4.0, 0.005
_FEW, _ROUNDS = 0.1, 3


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


def lens_distance(solution: Extrinsics, camera: CameraModel) -> TwoCentres | None:
    """Return the distance of the lenses that the observations tell.

    Parameters
    ----------
    solution : Extrinsics
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
    sides = np.concatenate([sight.bearings for sight in solution.network.sights]) @ _AXIS
    front = float((sides > 0).mean())
    clear = resolve(solution, _beside_seam(solution.network))
    column = clear.network.by_lens_distance(clear.poses, _AXIS)
    value, sigma = extra_parameter(clear, column)
    return TwoCentres(value, sigma, front)


def fit_two_centres(network: Network, start: Poses) -> tuple[Extrinsics, float]:
    """Fit camera and targets with two lens centres along the camera's x axis.

    Parameters
    ----------
    network : Network
        The observations, as from one centre.
    start : Poses
        Rough values.

    Returns
    -------
    solution : Extrinsics
        With two centres.
    distance : float
        Between them, in metres.
    """
    distance, network = 0.0, _beside_seam(network)
    solution = solve(network, start)
    for _ in range(_ROUNDS):
        step, _ = extra_parameter(solution, solution.network.by_lens_distance(solution.poses, _AXIS))
        distance += step
        solution = solve(network.with_lens_distance(distance, _AXIS), solution.poses)
    return solution, distance


def _beside_seam(network: Network) -> Network:
    """Return the network without corners near the seam, where it is open which of the lenses sees them."""
    return network.kept([np.abs(sight.bearings @ _AXIS) > np.sin(_BAND) for sight in network.sights])


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
