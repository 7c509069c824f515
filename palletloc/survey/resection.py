"""Free station: where a total station stands, from sights to points whose places are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.survey.polar import PolarObservation, Station, reduce_sight
from palletloc.survey.rigid_body import FitError, fit_level

_MAX_ROUNDS = 20
"""After which the iteration is given up; a few suffice."""
_STILL = 1e-10
"""Change of the unknowns, as a part of the largest coordinate, below which it has converged."""


class ResectionError(PalletLocError):
    """Sights that do not fix the station; gives the reason."""


@dataclass(frozen=True, slots=True)
class InstrumentSigma:
    """Standard deviations of an instrument's readings, prism centring included."""

    angle: float = math.radians(5 / 3600)
    """Of an angle, in radians."""
    distance: float = 1e-3
    """Of a distance, in metres."""
    per_metre: float = 1.5e-6
    """What a distance's grows by for each metre of it."""
    centring: float = 0.0
    """Of the prism on the point, in metres: turns every direction, the more the closer it is."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeStation:
    """A station found by resection."""

    station: Station
    """Where it is and how its circle is turned."""
    covariance: FloatArray
    """(4, 4) of easting, northing, height and orientation, in metres and radians."""
    residuals: FloatArray
    """(n, 3) for each sight: horizontal and vertical angle in radians, distance in metres or NaN."""
    chi2: float
    """Squared residuals in units of their variances: as large as `freedom` on average."""
    freedom: int
    """How many more numbers were measured than needed."""


def resect(
    sights: Sequence[PolarObservation], known: Mapping[str, FloatArray], sigma: InstrumentSigma | None = None
) -> FreeStation:
    """Find a station by Gauss-Newton from sights to known points.

    Parameters
    ----------
    sights : sequence of PolarObservation
        From one station; at least two of them with distances, to points that do not stand above one another.
    known : mapping of str to (3,) array
        Easting, northing and height of each target, in metres.
    sigma : InstrumentSigma
        What weighs angles against distances.

    Returns
    -------
    FreeStation
        With its covariance.

    Raises
    ------
    ResectionError
        If a target is not known, or the sights do not fix the station.
    """
    sigma = sigma or InstrumentSigma()
    for sight in sights:
        if sight.name not in known:
            raise ResectionError(f"point '{sight.name}' of line {sight.line} is not among the known points")
    weights = np.concatenate([_weights(sight, sigma) for sight in sights])
    try:
        # A point on the station or wild numbers give no slopes; that is bad input and no warning.
        with np.errstate(all="raise", under="ignore"):
            return _settled(sights, known, _first_guess(sights, known), weights)
    except (FloatingPointError, ZeroDivisionError, OverflowError, np.linalg.LinAlgError):
        raise ResectionError("the sights and the known points do not belong together: no station fits") from None


def _settled(
    sights: Sequence[PolarObservation], known: Mapping[str, FloatArray], station: Station, weights: FloatArray
) -> FreeStation:
    """Improve the station until it stands still."""
    for _ in range(_MAX_ROUNDS):
        errors, slopes = _linearized(sights, known, station)
        used = np.isfinite(errors)
        normal = slopes[used].T @ (slopes[used] * weights[used, None])
        step = np.linalg.solve(normal, slopes[used].T @ (errors[used] * weights[used]))
        station = Station(station.position + step[:3], wrap_angle(station.orientation + float(step[3])))
        if np.abs(step).max() < _STILL * (1 + np.abs(station.position).max()):
            break
    else:
        raise ResectionError(f"the free station does not settle after {_MAX_ROUNDS} rounds")
    errors, _ = _linearized(sights, known, station)
    chi2 = float((errors[used] ** 2 * weights[used]).sum())
    covariance = np.linalg.inv(normal)
    return FreeStation(station, (covariance + covariance.T) / 2, errors.reshape(-1, 3), chi2, int(used.sum()) - 4)


def _first_guess(sights: Sequence[PolarObservation], known: Mapping[str, FloatArray]) -> Station:
    """Return the station by fitting the reduced sights, as a level body, to the known points."""
    measured = [sight for sight in sights if sight.distance is not None]
    reduced = np.array([reduce_sight(sight, Station()) for sight in measured]).reshape(-1, 3)
    places = np.array([known[sight.name] for sight in measured]).reshape(-1, 3)
    try:
        pose = fit_level(reduced, places, 1e-3).pose.level
    except FitError as error:
        raise ResectionError(f"the known points do not fix the free station: {error}") from None
    # Azimuths run clockwise, headings the other way round.
    return Station(np.array([pose.x, pose.y, pose.z]), -pose.yaw)


def _weights(sight: PolarObservation, sigma: InstrumentSigma) -> FloatArray:
    distance = sight.distance or math.inf
    flat = distance * abs(math.sin(sight.zenith))
    horizontal = math.hypot(sigma.angle / max(abs(math.sin(sight.zenith)), 1e-6), sigma.centring / max(flat, 1e-3))
    vertical = math.hypot(sigma.angle, sigma.centring / distance)
    along = sigma.distance + sigma.per_metre * (sight.distance or 0.0)
    return np.array([horizontal, vertical, math.hypot(along, sigma.centring)]) ** -2.0


def _linearized(
    sights: Sequence[PolarObservation], known: Mapping[str, FloatArray], station: Station
) -> tuple[FloatArray, FloatArray]:
    """Return observed minus computed readings, (3 n,), and the computed ones' slopes by the unknowns, (3 n, 4)."""
    errors, slopes = [], []
    for sight in sights:
        up = np.array([0.0, 0.0, sight.reflector_height - sight.instrument_height])
        east, north, high = known[sight.name] + up - station.position
        flat2 = east**2 + north**2
        flat, distance = math.sqrt(flat2), math.sqrt(flat2 + high**2)
        zenith = 2 * math.pi - sight.zenith if sight.second_face else sight.zenith
        reading = sight.horizontal - math.pi if sight.second_face else sight.horizontal
        errors += [
            wrap_angle(reading + station.orientation - math.atan2(east, north)),
            zenith - math.atan2(flat, high),
            math.nan if sight.distance is None else sight.distance - distance,
        ]
        slopes += [
            [-north / flat2, east / flat2, 0.0, -1.0],
            [-east * high / (flat * distance**2), -north * high / (flat * distance**2), flat / distance**2, 0.0],
            [-east / distance, -north / distance, -high / distance, 0.0],
        ]
    return np.array(errors), np.array(slopes)
