r"""Poses that know the whole recording: the fixed-interval smoother of Rauch, Tung and Striebel.

The filter's pose after step k knows the shots up to k. Going back from the last step, with :math:`\hat x_k, P_k` what
the filter knew after step k and :math:`\hat x^-_{k+1}, P^-_{k+1}` what it expected after the motion that followed,

.. math::

    C_k = P_k F_{k+1}^T (P^-_{k+1})^{-1}, \quad
    \hat x^s_k = \hat x_k + C_k (\hat x^s_{k+1} - \hat x^-_{k+1}), \quad
    P^s_k = P_k + C_k (P^s_{k+1} - P^-_{k+1}) C_k^T .

The odometry is in :math:`\hat x^-_{k+1}`. It would not be in :math:`F_{k+1} \hat x_k`, which a smoother for motions
without input takes instead. Yaws are subtracted the short way round. (Rauch, Tung, Striebel, Maximum likelihood
estimates of linear dynamic systems, AIAA Journal 3, 1965; for filters whose F is a derivative, Särkkä, Bayesian
Filtering and Smoothing, 2013, section 9.1.)
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from tracking.config import TrackerConfig
from tracking.filter import PalletFilter
from tracking.history import Moment
from tracking.observation import YAW
from tracking.path import DrivenPath
from tracking.state import POSE, Gaussian
from tracking.track import Track

LEAST_SHARE = 1e-12
"""Part of the largest variance, in units of standard deviations, below which a direction counts as known exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedState:
    """A pallet at some time, as all shots of its track know it."""

    time: float
    """In seconds."""
    number: int
    """Of the track."""
    track: Track
    """What the filter knew after the step up to then."""
    state: Gaussian
    """What the smoother knows."""

    @property
    def pose(self) -> LevelPose:
        """``forklift_from_pallet`` at that time."""
        return LevelPose(*(float(value) for value in self.state.mean[POSE]))

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of (x, y, z, yaw), in metres and radians."""
        return self.state.covariance[POSE, POSE]


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedMoment:
    """All tracks after one step."""

    time: float
    """Of the step, in seconds."""
    states: tuple[SmoothedState, ...]
    """In the order of their numbers."""


def smoothed(history: Sequence[Moment]) -> tuple[SmoothedMoment, ...]:
    """Smooth all tracks.

    Parameters
    ----------
    history : sequence of Moment
        What the tracker believed, step by step (`PalletTracker.history`).

    Returns
    -------
    tuple of SmoothedMoment
        One for each step. A track that began anew is two: nothing is carried back over the break. Where the
        odometry's constants are only allowed for and not estimated, the filter's gain is not the best one, and the
        smoother's covariances are an approximation.
    """
    chains: dict[int, list[Track]] = {}
    for moment in history:
        for number, track in moment.tracks.items():
            chains.setdefault(number, []).append(track)
    states = {number: iter(smoothed_chain(chain)) for number, chain in chains.items()}
    return tuple(
        SmoothedMoment(
            moment.time,
            tuple(
                SmoothedState(moment.time, number, track, next(states[number]))
                for number, track in sorted(moment.tracks.items())
            ),
        )
        for moment in history
    )


def smoothed_at(
    times: Iterable[float], moments: Sequence[SmoothedMoment], path: DrivenPath, config: TrackerConfig
) -> tuple[SmoothedState, ...]:
    """Return the tracks at any times: those of the step before, carried on by odometry.

    Parameters
    ----------
    times : iterable of float
        In seconds.
    moments : sequence of SmoothedMoment
        In the order of time.
    path : DrivenPath
        All of the odometry.
    config : TrackerConfig
        Parameters of the filter.

    Returns
    -------
    tuple of SmoothedState
        Of the tracks that live at each time.
    """
    engine = PalletFilter(config)
    steps = [moment.time for moment in moments]
    states: list[SmoothedState] = []
    for time in times:
        before = bisect_right(steps, time) - 1
        motion = path.extrapolated(steps[before], time) if before >= 0 else None
        if motion is None:
            continue
        for one in moments[before].states:
            if one.track.is_too_old(time, config.life):
                continue
            state = one.state if motion.duration == 0 else engine.predicted([one.state], motion)[0].state
            states.append(SmoothedState(time, one.number, one.track, state))
    return tuple(states)


def smoothed_chain(chain: Sequence[Track]) -> list[Gaussian]:
    """Smooth one track.

    Parameters
    ----------
    chain : sequence of Track
        The track after each step, in order. Where one says that it was not predicted, it began there.

    Returns
    -------
    list of Gaussian
        One for each step.
    """
    states: list[Gaussian] = []
    later: Track | None = None
    for track in reversed(chain):
        if later is None or later.predicted is None:
            states.append(track.state)
        else:
            states.append(_back(track.state, later.predicted.state, later.predicted.F, states[-1]))
        later = track
    return states[::-1]


def _back(known: Gaussian, expected: Gaussian, F: FloatArray, later: Gaussian) -> Gaussian:
    """Return what is known after a step by all that is known after the next one."""
    gain = known.covariance @ F.T @ _inverse(expected.covariance)
    away = later.mean - expected.mean
    away[YAW] = wrap_angle(float(away[YAW]))
    mean = known.mean + gain @ away
    mean[YAW] = wrap_angle(float(mean[YAW]))
    covariance = known.covariance + gain @ (later.covariance - expected.covariance) @ gain.T
    return Gaussian(mean, (covariance + covariance.T) / 2)


def _inverse(covariance: FloatArray) -> FloatArray:
    """Return the inverse of a covariance, zero in directions that are known exactly.

    A constant without variance, such as that of a perfect odometry, learns nothing and teaches nothing.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    per_sigma = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    shares, directions = np.linalg.eigh(covariance * np.outer(per_sigma, per_sigma))
    counts = shares > LEAST_SHARE * max(float(shares[-1]), 1.0)
    inverse = (directions[:, counts] / shares[counts]) @ directions[:, counts].T
    return np.asarray(inverse * np.outer(per_sigma, per_sigma))
