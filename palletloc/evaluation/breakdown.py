"""Errors in groups: by pallet, by track, by distance, and by stop in the terms of ISO 9283 (industrial robots)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palletloc.evaluation.pose_error import PoseError, offsets
from palletloc.evaluation.run_match import ShotMatch
from palletloc.evaluation.statistics import Proportion, Spread, clopper_pearson, spread
from palletloc.evaluation.time_pairing import nearest_pairs
from palletloc.geometry import FloatArray, wrap_angle


@dataclass(frozen=True, slots=True)
class Spreads:
    """Statistics of the errors of a group; None for an empty one."""

    depth: Spread | None
    """Errors into the pallet, in metres."""
    along: Spread | None
    """Errors along the front, in metres."""
    height: Spread | None
    """Errors of the height, in metres."""
    yaw: Spread | None
    """Errors of the yaw, in radians."""
    position: Spread | None
    """Distances of the estimated from the true position, in metres; its bias is the median distance."""


def spreads(errors: Sequence[PoseError]) -> Spreads:
    """Return the statistics of some errors."""
    off = offsets(errors)
    depth, along, height, yaw = (spread(column) for column in off.T)
    return Spreads(depth, along, height, yaw, spread(np.linalg.norm(off[:, :3], axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class TrackErrors:
    """One track over all shots."""

    track: str
    """Its name."""
    pallets: tuple[str, ...]
    """Ids of the pallets that it was matched with, each time that they change: one, for a track that stays."""
    errors: tuple[PoseError, ...]
    """In the order of the shots."""
    false: int
    """In how many shots it belonged to no pallet."""


def by_pallet(errors: Iterable[PoseError]) -> dict[str, tuple[PoseError, ...]]:
    """Return the errors of each true pallet, by its id."""
    return _grouped(errors, lambda error: error.face.id)


def by_stop(
    errors: Iterable[PoseError], stops: Mapping[str, float], limit: float
) -> dict[tuple[str, str], tuple[PoseError, ...]]:
    """Return the errors at each stop of the forklift, each pallet on its own.

    Parameters
    ----------
    errors : iterable of PoseError
        Of all shots.
    stops : mapping of str to float
        When the forklift stood still, in seconds, by the stops' names.
    limit : float
        How far a shot may be from its stop's time, in seconds; it belongs to the nearest one.

    Returns
    -------
    dict
        By the names of stop and pallet; without the shots of no stop. What
        `stop_accuracy` takes are the `offsets` of a group.
    """
    errors = list(errors)
    names = list(stops)
    pairs = nearest_pairs(
        np.array([error.time for error in errors]), np.array([stops[name] for name in names]), limit
    )
    groups: dict[tuple[str, str], list[PoseError]] = {}
    for row, stop in zip(pairs.first, pairs.second, strict=True):
        groups.setdefault((names[stop], errors[row].face.id), []).append(errors[row])
    return {key: tuple(group) for key, group in groups.items()}


@dataclass(frozen=True, slots=True, eq=False)
class StopAccuracy:
    r"""How well a pose is met at one stop, over n repetitions.

    With the positions :math:`p_j` met, the commanded one :math:`p_c` (here: the truth) and the barycentre
    :math:`\bar p = \frac{1}{n} \sum p_j`:

    .. math::

        AP_p &= \lVert \bar p - p_c \rVert, \qquad
        RP = \bar l + 3 S_l, \qquad l_j = \lVert p_j - \bar p \rVert \\
        AP_c &= \bar c - c_c, \qquad RP_c = 3 S_c

    with :math:`\bar l` the mean of the :math:`l_j`, :math:`c` the yaw, and standard deviations
    :math:`S_l`, :math:`S_c` with n - 1 in the denominator. The standard asks for 30 repetitions.
    """

    n: int
    """Number of repetitions."""
    mean: FloatArray
    """(3,) barycentre minus the true position, in metres, in the axes of the positions given."""
    ap: float
    """Accuracy of the position :math:`AP_p`, in metres: 0 or more."""
    rp: float
    """Repeatability of the position :math:`RP`, in metres; NaN for a single repetition."""
    ap_yaw: float
    """Accuracy of the yaw :math:`AP_c`, in radians, with its sign."""
    rp_yaw: float
    """Repeatability of the yaw :math:`RP_c`, in radians, to be read as plus or minus; NaN for a single one."""


def stop_accuracy(offsets: FloatArray) -> StopAccuracy:
    """Return accuracy and repeatability of the poses met at one stop.

    Parameters
    ----------
    offsets : (n, 4) array
        Errors of three coordinates in metres, in axes that are the same for all of them, and of the yaw in
        radians: estimate minus truth. Where the truth of a stop is one pose, differences of errors are
        differences of estimates, so the repeatability is that of the estimates.

    Returns
    -------
    StopAccuracy
        Of that stop.

    Raises
    ------
    ValueError
        If there is no repetition or the shape does not fit.

    Examples
    --------
    >>> stop = stop_accuracy(np.array([[0.01, 0, 0, 0.02], [0.03, 0, 0, 0.02]]))
    >>> round(stop.ap, 6), round(stop.rp, 6), round(stop.ap_yaw, 6), round(stop.rp_yaw, 6)
    (0.02, 0.01, 0.02, 0.0)
    """
    offsets = np.asarray(offsets, dtype=np.float64)
    if offsets.ndim != 2 or offsets.shape[1] != 4 or not len(offsets):
        raise ValueError(f"offsets: expected (n, 4) with n at least 1, got {offsets.shape}")
    positions, yaw = offsets[:, :3], offsets[:, 3]
    mean = positions.mean(axis=0)
    distance = np.linalg.norm(positions - mean, axis=1)
    # about their direction, so that errors near half a turn do not cancel
    direction = float(np.angle(np.exp(1j * yaw).sum()))
    deviations = wrap_angle(yaw - direction)
    return StopAccuracy(
        n=len(offsets),
        mean=mean,
        ap=float(np.linalg.norm(mean)),
        rp=float(distance.mean()) + 3 * _scatter(distance),
        ap_yaw=wrap_angle(direction + float(deviations.mean())),
        rp_yaw=3 * _scatter(deviations),
    )


def _scatter(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else float("nan")


def by_track(shots: Iterable[ShotMatch]) -> tuple[TrackErrors, ...]:
    """Return the errors of each track, in the order in which the tracks are first seen.

    Parameters
    ----------
    shots : iterable of ShotMatch
        In the order of time. Pallets that need not be found take part: a track does not know of them.

    Returns
    -------
    tuple of TrackErrors
        Estimates without a track are left out.
    """
    shots = list(shots)
    names: dict[str, int] = {}
    for shot in shots:
        for estimate in (*(error.estimate for error in (*shot.errors, *shot.beyond)), *shot.false):
            names.setdefault(estimate.track, 0)
        for estimate in shot.false:
            names[estimate.track] += 1
    matched = (error for shot in shots for error in (*shot.errors, *shot.beyond))
    errors = _grouped(matched, lambda error: error.estimate.track)
    return tuple(
        TrackErrors(name, _changes(errors.get(name, ())), errors.get(name, ()), false)
        for name, false in names.items()
        if name
    )


def _changes(errors: Sequence[PoseError]) -> tuple[str, ...]:
    ids = [error.face.id for error in errors]
    return tuple(ids[:1] + [later for earlier, later in pairwise(ids) if later != earlier])


def _grouped(errors: Iterable[PoseError], name: Callable[[PoseError], str]) -> dict[str, tuple[PoseError, ...]]:
    groups: dict[str, list[PoseError]] = {}
    for error in errors:
        groups.setdefault(name(error), []).append(error)
    return {key: tuple(group) for key, group in groups.items()}


@dataclass(frozen=True, slots=True, eq=False)
class DistanceBin:
    """The pallets at some distance from the camera."""

    low: float
    """Least distance, in metres."""
    high: float
    """Distance that is too far already, in metres."""
    errors: tuple[PoseError, ...]
    """Of the pallets that were found."""
    found: Proportion
    """How many of those that had to be."""


def by_distance(shots: Iterable[ShotMatch], edges: Sequence[float]) -> tuple[DistanceBin, ...]:
    """Return the errors by the true distance of the pallet from the camera.

    Parameters
    ----------
    shots : iterable of ShotMatch
        In any order.
    edges : sequence of float
        Increasing distances in metres; k + 1 of them give k bins. Nothing is kept outside; infinity is allowed.

    Returns
    -------
    tuple of DistanceBin
        The nearest first; empty ones, too.

    Raises
    ------
    ValueError
        If there are less than two edges or they do not increase.
    """
    if len(edges) < 2 or not all(low < high for low, high in pairwise(edges)):
        raise ValueError(f"edges: expected at least two increasing distances, got {list(edges)}")
    shots = list(shots)
    found = [error for shot in shots for error in shot.errors]
    missed = np.array([face.range for shot in shots for face in shot.missed])
    return tuple(
        _bin(low, high, found, int(((missed >= low) & (missed < high)).sum())) for low, high in pairwise(edges)
    )


def _bin(low: float, high: float, found: Iterable[PoseError], missed: int) -> DistanceBin:
    inside = tuple(error for error in found if low <= error.face.range < high)
    return DistanceBin(low, high, inside, clopper_pearson(len(inside), len(inside) + missed))


def distance_edges(step: float, farthest: float) -> list[float]:
    """Return the edges of equally wide bins from 0 to at least the farthest distance, in metres.

    Raises
    ------
    ValueError
        If the step is not positive.

    Examples
    --------
    >>> distance_edges(1.5, 4.0)
    [0.0, 1.5, 3.0, 4.5]
    """
    if not step > 0:
        raise ValueError(f"step: expected a positive distance, got {step}")
    return [step * index for index in range(max(1, math.ceil(farthest / step)) + 1)]
