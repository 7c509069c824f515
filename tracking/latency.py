r"""How much later than its exposure a shot is stamped, estimated from the pallets in several shots and odometry.

A pallet stands still. Carried by odometry into one frame, its measurements should all give the same pose:

.. math:: y_i(\tau) = X_i \, S_i(-\tau) \, z_i = P + w_i + A_i c + L_i \beta_i + v_i

with :math:`X_i` the forklift's pose at the time of shot i, :math:`S_i(-\tau)` its motion from there to the exposure,
:math:`z_i` the measurement and :math:`P` the pallet, of which nothing is known. The errors are odometry's drift
:math:`w_i`, a random walk that all pallets share; its constant errors :math:`c`, wheel scale and gyro bias; the
error :math:`\beta` that a pallet's measurements share, which fades along the way; and the noise :math:`v_i`. The
likelihood of :math:`\tau`, with everything else left free, is what cross-correlation of the camera's motions with
the odometry's comes to when every error has its covariance (generalised least squares). Its logarithm is taken at
trial offsets, and its vertex by a parabola.

At constant speed :math:`\tau` moves all :math:`y_i` in the same way as another :math:`P` would: it is not observable.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from palletloc.geometry import FloatArray
from tracking.belief import Belief
from tracking.config import LatencyConfig, TrackerConfig
from tracking.driven_path import DrivenPath
from tracking.events import Event, EventKind
from tracking.shot_stack import LatencyShot, ShotStack, Sighting
from tracking.state import Key
from tracking.window import ShotMeasurements, Window

TRIALS = 21
"""How many offsets are tried; an odd number, so that none is one of them."""
ORDER = 3
"""Order of the polynomial that stands for the motion around a shot: it takes the noise out of single samples."""
FEWEST = 4
"""Shots below which nothing is said."""
NOISE_SHARE = 0.25
"""Largest part of the information from changes of speed that the odometry's noise may account for."""
MOST_MISFIT = 3.0
"""Misfit over its expectation above which the measurements contradict each other at every offset."""
MOST_PALLETS = 4
"""How many pallets of a shot are compared, those known longest: the cost grows with the third power of all."""
PLANE = np.ix_((0, 1, 3), (0, 1, 3))
"""Where x, y and yaw are in a covariance of (x, y, z, yaw)."""


@dataclass(frozen=True, slots=True)
class LatencyEstimate:
    """How much later than its exposure a shot is stamped, beyond `MeasurementErrors.latency_s`."""

    offset: float = math.nan
    """In seconds; positive where the stamps are late. NaN where it is not observable."""
    sigma: float = math.inf
    """Standard deviation, in seconds."""
    observable: bool = False
    """Whether speed varied by more than the noise, and the vertex is inside the search."""
    shots: int = 0
    """How many shots were compared."""


def _trial_offsets(config: LatencyConfig) -> FloatArray:
    """Return the (TRIALS,) latencies that are tried, in seconds."""
    return np.linspace(-config.search_s, config.search_s, TRIALS)


def _estimated(shots: Sequence[LatencyShot], config: TrackerConfig) -> LatencyEstimate:
    """Estimate the latency from shots in the order of time.

    Parameters
    ----------
    shots : sequence of LatencyShot
        Without any whose odometry is not known.
    config : TrackerConfig
        With what is known of odometry's and measurements' errors.

    Returns
    -------
    LatencyEstimate
        Its `observable` is false where the shots do not determine it.
    """
    found, misfit = _vertex(shots, [(*shot.sightings, *shot.rejected) for shot in shots], config)
    if misfit > MOST_MISFIT and any(shot.rejected for shot in shots):
        found, misfit = _vertex(shots, [shot.sightings for shot in shots], config)
    return found if misfit <= MOST_MISFIT else LatencyEstimate(shots=found.shots)


def _vertex(
    shots: Sequence[LatencyShot], sightings: Sequence[tuple[Sighting, ...]], config: TrackerConfig
) -> tuple[LatencyEstimate, float]:
    """Return the estimate from some of the sightings, and their misfit there over its expectation."""
    limits = config.latency
    constants = np.zeros(2)
    # what odometry's constant errors do is linear only near their true values: a coarse shot comes first
    for most in (limits.max_sightings // 3, limits.max_sightings):
        chosen = _chosen(sightings, most)
        count = len(chosen)
        if count < FEWEST:
            return LatencyEstimate(shots=count), 0.0
        try:
            misfits, constants, noise, freedom = _profile(ShotStack(shots, chosen, constants), config)
        except np.linalg.LinAlgError:  # odometry so uncertain that rounding hides everything else
            return LatencyEstimate(shots=count), 0.0
    best = int(np.argmin(misfits))
    # measurements that agree worse than their covariances say make the answer less sure, better ones no surer
    worse = max(1.0, float(misfits[best]) / max(freedom, 1))
    if best in (0, TRIALS - 1):
        return LatencyEstimate(shots=count), worse
    step = 2 * limits.search_s / (TRIALS - 1)
    low, middle, high = misfits[best - 1 : best + 2]
    bend = low - 2 * middle + high
    if not bend > 0:
        return LatencyEstimate(shots=count), worse
    offset = float(_trial_offsets(limits)[best] + step * (low - high) / (2 * bend))
    information = float(bend / (2 * step**2))
    pretended = noise * _jitter_rate(limits.search_s, offset)
    if pretended > NOISE_SHARE * information:
        return LatencyEstimate(shots=count), worse
    sigma = math.sqrt(worse / (information - pretended))
    if sigma > limits.max_sigma_s:
        return LatencyEstimate(sigma=sigma, shots=count), worse
    return LatencyEstimate(offset, sigma, True, count), worse


def _chosen(sightings: Sequence[tuple[Sighting, ...]], most: int) -> list[tuple[int, tuple[Sighting, ...]]]:
    """Return shots by their numbers, evenly, with sightings of pallets that are seen more than once."""
    total = sum(len(several) for several in sightings)
    stride = max(1, math.ceil(total / most))
    taken = [(i, sightings[i]) for i in range(len(sightings) - 1, -1, -stride)][::-1]
    times: dict[Key, int] = {}
    for _, several in taken:
        for sighting in several:
            times[sighting.pallet] = times.get(sighting.pallet, 0) + 1
    again = [(i, tuple(sighting for sighting in several if times[sighting.pallet] > 1)) for i, several in taken]
    return [(i, several) for i, several in again if several]


class _Profile(NamedTuple):
    """How well the sightings agree at the trial offsets."""

    misfits: FloatArray
    """(TRIALS,) squared, in units of their covariance."""
    constants: FloatArray
    """(2,) odometry's constant errors where they agree best."""
    noise: float
    """Information that jitter of one unit in the rates would add wrongly."""
    freedom: int
    """Degrees of freedom of the misfit."""


def _profile(stack: ShotStack, config: TrackerConfig) -> _Profile:
    sigmas = config.odometry.constants
    rows, each = 3 * len(stack.shot), np.arange(len(stack.shot))
    shots = np.arange(len(stack.walk))
    drift = stack.spread(stack.walk, (shots <= stack.shot[:, None]).astype(np.float64))
    covariance = drift @ drift.T + stack.shared(config.errors.common_path_m)
    covariance.reshape(len(each), 3, len(each), 3)[each, :, each, :] += stack.own
    root = cholesky(covariance, lower=True, check_finite=False)
    free = stack.free(sigmas)
    noise = stack.spread(stack.jitter, np.eye(len(shots))[stack.shot])
    white = solve_triangular(root, np.hstack([stack.from_first(), free, noise]), lower=True, check_finite=False)
    seen, by_free, by_noise = np.split(white, [TRIALS, TRIALS + free.shape[1]], axis=1)
    prior, before = np.zeros(free.shape[1]), np.zeros((free.shape[1], 1))
    prior[-2:], before[-2:, 0] = 1.0, np.divide(stack.mended, sigmas, out=np.zeros(2), where=sigmas > 0)
    factor = cho_factor(by_free.T @ by_free + np.diag(prior), check_finite=False)
    found = cho_solve(factor, by_free.T @ seen - before, check_finite=False)
    misfits = np.sum((seen - by_free @ found) ** 2, axis=0) + prior @ (found + before) ** 2
    constants = stack.mended + sigmas * found[-2:, np.argmin(misfits)]
    return _Profile(misfits, constants, float(np.sum(by_noise**2)), rows - free.shape[1] + 1)


@lru_cache(maxsize=1)
def _smoothing() -> FloatArray:
    """Return the (TRIALS, TRIALS) matrix that replaces values at the offsets by a polynomial without constant."""
    powers = _powers()
    return np.asarray(powers @ np.linalg.pinv(powers))


def _jitter_rate(search: float, offset: float) -> float:
    """Return the variance of the rate that `_smoothing` makes of a random walk of 1 unit per root second.

    Parameters
    ----------
    search : float
        Largest trial offset, in seconds.
    offset : float
        Where, in seconds.
    """
    offsets = np.linspace(-search, search, TRIALS)
    slopes = np.array([power * (offset / search) ** (power - 1) for power in range(1, ORDER + 1)]) / search
    slope = slopes @ np.linalg.pinv(_powers())
    common = np.minimum.outer(np.abs(offsets), np.abs(offsets))
    walk = np.where(np.multiply.outer(offsets, offsets) > 0, common, 0.0)
    return float(slope @ walk @ slope)


def _powers() -> FloatArray:
    unit = np.linspace(-1, 1, TRIALS)
    return np.stack([unit**power for power in range(1, ORDER + 1)], axis=1)


class LatencyWatch:
    """Collects shots that are final, and reports the camera's latency when it becomes significant.

    Parameters
    ----------
    config : TrackerConfig
        Parameters.
    """

    def __init__(self, config: TrackerConfig) -> None:
        self._config = config
        self.shots: list[LatencyShot] = []
        self.since = 0
        """Shots since the last estimate."""
        self.reported: float | None = None
        """The latency that was reported last, in seconds."""

    def estimate(self) -> LatencyEstimate:
        """Return the estimate from the shots that are kept."""
        return _estimated(self.shots, self._config)

    def of_final(self, window: Window, horizon: float) -> list[Event]:
        """Take the shots that no input can change any more; return a new or changed latency.

        Parameters
        ----------
        window : Window
            Before it forgets them.
        horizon : float
            Time before which they are final, in seconds.
        """
        events: list[Event] = []
        count = window.final_count(horizon)
        for shot, belief in zip(window.shots[:count], window.beliefs[:count], strict=True):
            if self._take(shot, belief, window.path):
                self.since += 1
            if self.since >= self._config.latency.every:
                self.since = 0
                events += self._events(shot.time)
        return events

    def _events(self, time: float) -> list[Event]:
        limits, found = self._config.latency, self.estimate()
        if not found.observable:
            return []
        if self.reported is None:
            new = abs(found.offset) > max(limits.least_s, limits.significance * found.sigma)
        else:
            new = abs(found.offset - self.reported) > found.sigma
        if not new:
            return []
        self.reported = found.offset
        figure = f"{1e3 * abs(found.offset):.1f} +- {1e3 * found.sigma:.1f} ms"
        side = "later" if found.offset > 0 else "earlier"
        reason = f"shots are stamped {figure} {side} than they are exposed, by odometry's time ({found.shots} shots)"
        return [Event(EventKind.LATENCY, time, reason=reason)]

    def _take(self, shot: ShotMeasurements, belief: Belief, path: DrivenPath) -> bool:
        """Take a shot; return whether it is of use."""
        limits = self._config.latency
        if self.shots and shot.time < self.shots[-1].time + limits.spacing_s:
            return False
        accepted = _sightings(shot, belief, EventKind.ACCEPTED)
        rejected = _sightings(shot, belief, EventKind.GATED)
        around = self._around(shot.time, path) if accepted or rejected else None
        if around is None:
            return False
        motion = path.motion(self.shots[-1].time if self.shots else shot.time, shot.time)
        nearby = path.motion(shot.time - limits.search_s, shot.time + limits.search_s)
        if nearby is None:
            return False
        if motion is None:
            self.shots.clear()
            motion = path.motion(shot.time, shot.time)
        if motion is None:
            return False
        jitter = nearby.covariance / nearby.duration
        self.shots.append(LatencyShot(shot.time, motion, around, jitter, accepted, rejected))
        while shot.time - self.shots[0].time > limits.span_s:
            del self.shots[0]
        return True

    def _around(self, time: float, path: DrivenPath) -> FloatArray | None:
        """Return where the forklift was at the trial offsets; None where odometry does not say."""
        limits = self._config.latency
        offsets = _trial_offsets(limits)
        within = path.rates_within(time - limits.search_s, time + limits.search_s)
        if within is None or np.diff(within[0]).max() > limits.max_gap_s:
            return None
        times, rates = within
        spans = np.diff(times)
        heading = np.concatenate([[0.0], np.cumsum(spans * rates[:, 2])])
        heading -= np.interp(time, times, heading)
        middle = (heading[:-1] + heading[1:]) / 2
        cos, sin = np.cos(middle), np.sin(middle)
        ahead, aside = spans * rates[:, 0], spans * rates[:, 1]
        ways = np.concatenate([[[0.0, 0.0]], np.cumsum([cos * ahead - sin * aside, sin * ahead + cos * aside], 1).T])
        poses = np.column_stack([ways, heading])
        now = np.array([np.interp(time, times, column) for column in poses.T])
        at = time - offsets
        exposed = np.stack([np.interp(at, times, column) for column in (poses - now).T], axis=1)
        return np.asarray(_smoothing() @ exposed)


def _sightings(shot: ShotMeasurements, belief: Belief, kind: EventKind) -> tuple[Sighting, ...]:
    """Return the whole poses of a shot that a track took, or rejected in its place."""
    found = [
        (disposition.key, each)
        for each, disposition in zip(shot.observations, belief.dispositions, strict=True)
        if disposition.kind is kind and disposition.key is not None and each.is_whole
    ]
    found.sort(key=lambda pair: pair[0])
    return tuple(
        Sighting(key, each.values[[0, 1, 3]], each.own[PLANE], each.common[[0, 1, 3]])
        for key, each in found[:MOST_PALLETS]
    )
