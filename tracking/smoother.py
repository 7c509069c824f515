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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from tracking.belief import Belief
from tracking.config import TrackerConfig
from tracking.driven_path import DrivenPath
from tracking.filter import GroupFilter
from tracking.observation import YAW
from tracking.state import POSE, Gaussian, Key, TrackGroup, members_of, places_among, places_of
from tracking.track import Track

LEAST_SHARE = 1e-12
"""Part of the largest variance, in units of standard deviations, below which a direction counts as known exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The tracks after one step: a shot, or a motion without one."""

    time: float
    """Of its end, in seconds."""
    tracks: Mapping[int, Track]
    """By their numbers."""
    groups: tuple[TrackGroup, ...]
    """What is known of them together."""


class History:
    """Takes up the beliefs whose steps are final, with the numbers that their tracks had."""

    def __init__(self) -> None:
        self.final: list[Belief] = []
        """In the order of their times."""
        self._numbers: dict[Key, int] = {}
        self._named = 0

    def record_numbers(self, numbers: Mapping[Key, int]) -> None:
        """Take note of the numbers of tracks in beliefs that have come since."""
        for belief in self.final[self._named :]:
            self._numbers |= {track.key: numbers[track.key] for track in belief.tracks}
        self._named = len(self.final)

    def moments(self, latest: Sequence[Belief], numbers: Mapping[Key, int]) -> tuple[Moment, ...]:
        """Return all steps; shots that wait for odometry are none.

        Parameters
        ----------
        latest : sequence of Belief
            Those that are not final yet.
        numbers : mapping
            Numbers of their tracks.
        """
        known = {**self._numbers, **numbers}
        steps: list[Moment] = []
        for belief in (step for each in (*self.final, *latest) for step in (*each.via, each)):
            if belief.time is not None and not (steps and belief.time <= steps[-1].time):
                tracks = {known[track.key]: track for track in belief.tracks}
                steps.append(Moment(belief.time, tracks, belief.groups))
        return tuple(steps)


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
    steps = [moment.groups for moment in history]
    known = [
        {
            key: member
            for group, state in zip(groups, states, strict=True)
            for key, member in zip(group.keys, members_of(state), strict=True)
        }
        for groups, states in zip(steps, smoothed_groups(steps), strict=True)
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
    group_filter = GroupFilter(config)
    steps = [moment.time for moment in moments]
    states: list[SmoothedState] = []
    for time in times:
        before = bisect_right(steps, time) - 1
        motion = path.extrapolated(steps[before], time) if before >= 0 else None
        if motion is None:
            continue
        for known in moments[before].states:
            if known.track.is_too_old(time, config.life):
                continue
            state = known.state if motion.duration == 0 else group_filter.predict([known.state], motion)[0]
            states.append(SmoothedState(time, known.number, known.track, state))
    return tuple(states)


def smoothed_groups(steps: Sequence[Sequence[TrackGroup]]) -> list[list[Gaussian]]:
    """Smooth what is known of pallets together.

    Parameters
    ----------
    steps : sequence of sequence of TrackGroup
        The groups after each step, in order.

    Returns
    -------
    list of list of Gaussian
        One state for each of them.
    """
    found: list[list[Gaussian]] = []
    later: list[tuple[TrackGroup, Gaussian]] = []
    for groups in reversed(steps):
        following = {key: pair for pair in later for key in pair[0].carried}
        states = []
        for group in groups:
            after = next((following[key] for key in group.keys if key in following), None)
            states.append(group.state if after is None else _back(group.state, *after))
        found.append(states)
        later = list(zip(groups, states, strict=True))
    return found[::-1]


def _back(known: Gaussian, later: TrackGroup, smooth: Gaussian) -> Gaussian:
    """Return what is known after a step by all that is known after the next one.

    By the pallets that lived on through that, which hold all that was learnt after it.
    """
    predicted = later.predicted
    if predicted is None:
        return known
    before, now = places_among(predicted.keys, later.carried), later.places(later.carried)
    expected = Gaussian(predicted.state.mean[before], predicted.state.covariance[np.ix_(before, before)])
    gain = known.covariance @ predicted.F[before].T @ _inverse(expected.covariance)
    innovation = smooth.mean[now] - expected.mean
    yaws = places_of(len(later.carried))[:, YAW]
    innovation[yaws] = wrap_angle(innovation[yaws])
    mean = known.mean + gain @ innovation
    yaws = places_of(len(predicted.keys))[:, YAW]
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
