"""What the watch on the camera's latency remembers, as plain values that JSON knows."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict

from palletloc.geometry import FloatArray
from tracking.latency_watch import LatencyWatch
from tracking.motion import Motion
from tracking.sightings import SeenFrom, Sighting
from tracking.snapshot_form import KeyForm, as_key, plain_key
from tracking.track import Key

Rows = list[list[float]]
"""A matrix."""


class _Plain(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class SightingForm(_Plain):
    """A `Sighting`."""

    pallet: KeyForm
    pose: list[float]
    own: Rows
    common: Rows


class SeenFromForm(_Plain):
    """A `SeenFrom`."""

    time: float
    increment: list[float]
    noise: Rows
    constants: Rows
    path: float
    duration: float
    around: Rows
    jitter: Rows
    sightings: list[SightingForm]
    rejected: list[SightingForm]


class LatencyForm(_Plain):
    """A `LatencyWatch`."""

    since: int
    told: float | None
    shots: list[SeenFromForm]


def plain_watch(watch: LatencyWatch) -> LatencyForm:
    """Return what a watch remembers as plain values."""
    return LatencyForm(since=watch.since, told=watch.told, shots=[_plain_shot(one) for one in watch.shots])


def restore_watch(plain: LatencyForm, watch: LatencyWatch) -> None:
    """Let a watch remember what another one did."""
    watch.since, watch.told = plain.since, plain.told
    watch.shots = [_as_shot(one) for one in plain.shots]


def _plain_shot(one: SeenFrom) -> SeenFromForm:
    motion = one.motion
    return SeenFromForm(
        time=one.time,
        increment=motion.increment.tolist(),
        noise=motion.covariance.tolist(),
        constants=motion.constants.tolist(),
        path=float(motion.path),
        duration=float(motion.duration),
        around=one.around.tolist(),
        jitter=one.jitter.tolist(),
        sightings=[_plain_sighting(each) for each in one.sightings],
        rejected=[_plain_sighting(each) for each in one.rejected],
    )


def _as_shot(plain: SeenFromForm) -> SeenFrom:
    increment, noise, constants = (_array(rows) for rows in (plain.increment, plain.noise, plain.constants))
    return SeenFrom(
        plain.time,
        Motion(increment, noise, constants, plain.path, plain.duration),
        _array(plain.around),
        _array(plain.jitter),
        tuple(_as_sighting(each) for each in plain.sightings),
        tuple(_as_sighting(each) for each in plain.rejected),
    )


def _plain_sighting(one: Sighting) -> SightingForm:
    if not isinstance(one.pallet, Key):
        raise TypeError(f"expected a pallet that a track names, got {type(one.pallet).__name__}")
    return SightingForm(
        pallet=plain_key(one.pallet), pose=one.pose.tolist(), own=one.own.tolist(), common=one.common.tolist()
    )


def _as_sighting(plain: SightingForm) -> Sighting:
    return Sighting(as_key(plain.pallet), _array(plain.pose), _array(plain.own), _array(plain.common))


def _array(rows: list[float] | Rows) -> FloatArray:
    return np.array(rows, dtype=np.float64)
