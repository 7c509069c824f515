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
from tracking.joint import Joint, joint_of, picked, places_of
from tracking.observation import YAW
from tracking.path import DrivenPath
from tracking.state import POSE, Gaussian
from tracking.track import Key, Track

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
    chains = [one.joints for one in history]
    known = [
        {key: state for joint, whole in zip(joints, states, strict=True) for key, state in _members(joint, whole)}
        for joints, states in zip(chains, smoothed_joints(chains), strict=True)
    ]
    return tuple(
        SmoothedMoment(
            moment.time,
            tuple(
                SmoothedState(moment.time, number, track, states[track.key])
                for number, track in sorted(moment.tracks.items())
            ),
        )
        for moment, states in zip(history, known, strict=True)
    )


def _members(joint: Joint, state: Gaussian) -> Iterable[tuple[Key, Gaussian]]:
    return zip(joint.keys, joint_of(joint.keys, state).members, strict=True)


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


def smoothed_joints(steps: Sequence[Sequence[Joint]]) -> list[list[Gaussian]]:
    """Smooth what is known of pallets together.

    Parameters
    ----------
    steps : sequence of sequence of Joint
        The estimates after each step, in order.

    Returns
    -------
    list of list of Gaussian
        One for each of them.
    """
    found: list[list[Gaussian]] = []
    later: list[tuple[Joint, Gaussian]] = []
    for joints in reversed(steps):
        following = {key: one for one in later for key in one[0].carried}
        states = []
        for joint in joints:
            after = next((following[key] for key in joint.keys if key in following), None)
            states.append(joint.state if after is None else _back(joint.state, *after))
        found.append(states)
        later = list(zip(joints, states, strict=True))
    return found[::-1]


def _back(known: Gaussian, later: Joint, smooth: Gaussian) -> Gaussian:
    """Return what is known after a step by all that is known after the next one.

    By the pallets that lived on through that, which tell all that was learnt after it.
    """
    foretold = later.foretold
    if foretold is None:
        return known
    before, now = picked(foretold.keys, later.carried), picked(later.keys, later.carried)
    expected = Gaussian(foretold.state.mean[before], foretold.state.covariance[np.ix_(before, before)])
    gain = known.covariance @ foretold.F[before].T @ _inverse(expected.covariance)
    away = smooth.mean[now] - expected.mean
    yaws = places_of(len(later.carried))[:, YAW]
    away[yaws] = wrap_angle(away[yaws])
    mean = known.mean + gain @ away
    yaws = places_of(len(foretold.keys))[:, YAW]
    mean[yaws] = wrap_angle(mean[yaws])
    covariance = known.covariance + gain @ (smooth.covariance[np.ix_(now, now)] - expected.covariance) @ gain.T
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
