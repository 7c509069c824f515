r"""The Kalman filter of pallets that share one estimate.

The equations are those of `tracking.filter`, with the states of m pallets put together. One motion moves them all:
with :math:`B_i` the derivative of pallet i's pose by the motion and :math:`B = (B_1, \dots, B_m)`, its noise enters
as :math:`B \Sigma B^T`, also between the pallets. A measurement of any of them corrects all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from palletloc.geometry import FloatArray, wrap_angle
from tracking import stacked
from tracking.filter import PalletFilter, all_away
from tracking.joint import Foretold, Joint, members_of, places_of, size_of
from tracking.motion import Motion
from tracking.observation import YAW, Observation
from tracking.stacked import symmetric
from tracking.state import CONSTANTS, POSE, SIZE, Gaussian

HEIGHT = 2
"""Index of the height in a pose."""


class Seen(NamedTuple):
    """A measurement of one of the pallets that share an estimate."""

    member: int
    """Which pallet of theirs."""
    observation: Observation
    """The measurement."""
    scale: float = 1.0
    """Factor on its covariance."""
    weight: float = 1.0
    """How much it counts, up to 1: a robust weight."""


class JointFilter:
    """Predicts and updates estimates that pallets share; without memory.

    Parameters
    ----------
    engine : PalletFilter
        The filter of a pallet alone.
    """

    def __init__(self, engine: PalletFilter) -> None:
        self._engine = engine

    def predicted(self, joints: Sequence[Joint], motion: Motion) -> list[Joint]:
        """Return estimates after a motion of the forklift."""
        return _by_size(joints, lambda count, group: self._predicted(count, [joints[i] for i in group], motion))

    def updated(self, joints: Sequence[Joint], seen: Sequence[Sequence[Seen]]) -> list[Joint]:
        """Return estimates after a shot.

        Parameters
        ----------
        joints : sequence of Joint
            Before it.
        seen : sequence of sequence of Seen
            For each of them the measurements of its pallets, at most one of each.
        """

        def step(count: int, group: Sequence[int]) -> list[Joint]:
            return self._updated(count, [joints[i] for i in group], [seen[i] for i in group])

        return _by_size(joints, step)

    def _transitions(
        self, count: int, means: FloatArray, motion: Motion
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return F, Q and the states after a motion, of many states of as many pallets each."""
        groups, size, places = len(means), size_of(count), places_of(count)
        fixed, noise = self._engine.alike(motion)
        by_state, by_motion, after = stacked.transitions(means[:, places].reshape(-1, SIZE), motion, fixed)
        F, moved = np.zeros((groups, size, size)), np.empty((groups, size))
        F[:, places[:, :, None], places[:, None, :]] = by_state.reshape(groups, count, SIZE, SIZE)
        moved[:, places] = after.reshape(groups, count, SIZE)
        B = np.zeros((groups, size, 4))
        B[:, places[:, POSE], :3] = by_motion.reshape(groups, count, 4, 3)
        B[:, places[:, HEIGHT], 3] = 1.0
        new, own = np.zeros((4, 4)), noise.diagonal().copy()
        new[:3, :3], new[3, 3] = motion.covariance, self._engine.height_noise(motion)
        own[HEIGHT] -= new[3, 3]
        Q = B @ new @ B.transpose(0, 2, 1)
        Q[:, places, places] += own  # the constants, which all have in common, have none
        return F, Q, moved

    def _predicted(self, count: int, joints: Sequence[Joint], motion: Motion) -> list[Joint]:
        if count == 1:
            found = self._engine.predicted([one.state for one in joints], motion)
            return [
                Joint(one.keys, state, (state,), Foretold(one.keys, state, F), one.keys)
                for one, (state, F) in zip(joints, found, strict=True)
            ]
        means, P = _stacked(joints)
        F, Q, means = self._transitions(count, means, motion)
        P = stacked.carried(P, F, Q)
        foretold = [
            Foretold(one.keys, Gaussian(*state), by_state)
            for one, *state, by_state in zip(joints, means, P, F, strict=True)
        ]
        return [
            Joint(one.keys, one.state, members, one, one.keys)
            for one, members in zip(foretold, members_of(means, P, count), strict=True)
        ]

    def _updated(self, count: int, joints: Sequence[Joint], seen: Sequence[Sequence[Seen]]) -> list[Joint]:
        if count == 1:
            states = self._alone(joints, seen)
            members: list[tuple[Gaussian, ...]] = [(state,) for state in states]
        else:
            means, P = self._corrected(count, joints, seen)
            states = [Gaussian(*state) for state in zip(means, P, strict=True)]
            members = members_of(means, P, count)
        return [
            Joint(one.keys, state, own, one.foretold, one.carried)
            for one, state, own in zip(joints, states, members, strict=True)
        ]

    def _alone(self, joints: Sequence[Joint], seen: Sequence[Sequence[Seen]]) -> list[Gaussian]:
        """Return states of pallets that share their estimate with none."""
        found = [joint.state for joint in joints]
        hits = [(i, hit) for i, hits in enumerate(seen) for hit in hits]
        if len(hits) == 1:
            ((i, one),) = hits
            found[i] = self._engine.updated(found[i], one.observation, one.scale, one.weight)
            return found
        for _, alike in groupby(hits, key=lambda one: one[1].observation.components):
            group = list(alike)
            ones = [hit for _, hit in group]
            after = self._engine.updates(
                [found[i] for i, _ in group],
                [one.observation for one in ones],
                [one.scale for one in ones],
                [one.weight for one in ones],
            )
            for (i, _), state in zip(group, after, strict=True):
                found[i] = state
        return found

    def _corrected(
        self, count: int, joints: Sequence[Joint], seen: Sequence[Sequence[Seen]]
    ) -> tuple[FloatArray, FloatArray]:
        means, P = _stacked(joints)
        H, R, away = self._models(count, means, seen)
        K = self._gains(P, H, R)
        if K is not None:
            return _joseph(count, means, P, H, R, away, K)
        if len(joints) > 1:  # rounding has spoilt one of them
            each = [self._corrected(count, [one], [hits]) for one, hits in zip(joints, seen, strict=True)]
            return np.concatenate([mean for mean, _ in each]), np.concatenate([own for _, own in each])
        return self._one_by_one(count, means, P, seen[0])

    def _one_by_one(
        self, count: int, mean: FloatArray, P: FloatArray, seen: Sequence[Seen]
    ) -> tuple[FloatArray, FloatArray]:
        """Return a state after one measurement at a time; one that spoils the numbers is left out."""
        for hit in seen:
            H, R, away = self._models(count, mean, [[hit]])
            K = self._gains(P, H, R)
            if K is not None:
                mean, P = _joseph(count, mean, P, H, R, away, K)
        return mean, P

    def _models(
        self, count: int, means: FloatArray, seen: Sequence[Sequence[Seen]]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return H, R and innovations, four rows for each pallet; rows of what was not measured say nothing."""
        groups, size, places = len(means), size_of(count), places_of(count)
        H, away = np.zeros((groups, 4 * count, size)), np.zeros((groups, 4 * count))
        R = np.repeat(np.eye(4 * count)[None], groups, axis=0)
        hits = sorted(
            ((hit.observation.components, i, hit) for i, hits in enumerate(seen) for hit in hits),
            key=lambda one: one[0],
        )
        for components, alike in groupby(hits, key=lambda one: one[0]):
            group = list(alike)
            ones = [hit for _, _, hit in group]
            which = np.array([i for _, i, _ in group])[:, None]
            member = np.array([one.member for one in ones])
            rows, columns = 4 * member[:, None] + np.arange(len(components)), places[member]
            H_own, R_own = self._engine.models([one.observation for one in ones], [one.scale for one in ones])
            H[which[:, :, None], rows[:, :, None], columns[:, None, :]] = H_own
            weights = np.array([one.weight for one in ones])[:, None, None]
            R[which[:, :, None], rows[:, :, None], rows[:, None, :]] = R_own / weights
            away[which, rows] = all_away([one.observation for one in ones], H_own, means[which, columns])
        return H, R, away

    def _gains(self, P: FloatArray, H: FloatArray, R: FloatArray) -> FloatArray | None:
        """Return the gains; None where rounding has left a covariance of innovations that is none."""
        of_state = P @ H.transpose(0, 2, 1)
        S = H @ of_state + R
        variances = np.einsum("nii->ni", S)
        if not (variances > 0).all():
            return None
        per_sigma = 1 / np.sqrt(variances)
        scales = per_sigma[:, :, None] * per_sigma[:, None, :]
        try:
            np.linalg.cholesky(S * scales)
            K = np.asarray(of_state @ (scales * np.linalg.inv(S * scales)))
        except np.linalg.LinAlgError:
            return None
        if not self._engine.estimated:
            K[:, CONSTANTS] = 0.0
        return K


def _joseph(
    count: int, means: FloatArray, P: FloatArray, H: FloatArray, R: FloatArray, away: FloatArray, K: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states and covariances after measurements, in Joseph's form."""
    means = means + (K @ away[:, :, None])[:, :, 0]
    yaws = places_of(count)[:, YAW]
    means[:, yaws] = wrap_angle(means[:, yaws])
    stays = np.eye(means.shape[1]) - K @ H
    return means, symmetric(stays @ P @ stays.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1))


def _by_size(joints: Sequence[Joint], step: Callable[[int, Sequence[int]], list[Joint]]) -> list[Joint]:
    """Do a step for all estimates of as many pallets at once; return them in their order."""
    sizes = [len(joint.keys) for joint in joints]
    different = set(sizes)
    if len(different) == 1:
        return step(sizes[0], range(len(joints)))
    found: dict[int, Joint] = {}
    for count in different:
        group = [i for i, size in enumerate(sizes) if size == count]
        found.update(zip(group, step(count, group), strict=True))
    return [found[i] for i in range(len(joints))]


def _stacked(joints: Sequence[Joint]) -> tuple[FloatArray, FloatArray]:
    return np.array([one.state.mean for one in joints]), np.array([one.state.covariance for one in joints])
