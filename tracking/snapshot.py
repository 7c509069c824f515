"""A tracker's memory as plain values that JSON knows, for a restart without loss.

Kept is what was believed before the window and every input inside it; the steps in between are done again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from pydantic import TypeAdapter, ValidationError

from palletloc.errors import PalletLocError
from tracking.belief import Belief
from tracking.clock import Clock
from tracking.config import TrackerConfig
from tracking.latency_watch import LatencyWatch
from tracking.naming import Names
from tracking.news import News
from tracking.replay import Look, Replay
from tracking.snapshot_form import (
    BaseForm,
    Input,
    LookForm,
    NewsForm,
    SnapshotBase,
    as_held,
    as_joint,
    as_key,
    as_observations,
    as_odometry,
    as_track,
    plain_held,
    plain_joint,
    plain_key,
    plain_measured,
    plain_odometry,
    plain_track,
)
from tracking.snapshot_latency import LatencyForm, plain_watch, restore_watch

VERSION = 2
"""Of the form; another one is refused."""


class SnapshotForm(SnapshotBase):
    """All that a tracker remembers."""

    latency: LatencyForm


class SnapshotError(PalletLocError):
    """A snapshot that cannot be restored."""


def written(
    config: TrackerConfig, clock: Clock, replay: Replay, news: News, watch: LatencyWatch, held: Sequence[Input]
) -> dict[str, Any]:
    """Return a tracker's memory as plain values.

    Parameters
    ----------
    config : TrackerConfig
        Parameters.
    clock, replay, news, watch
        What the tracker consists of.
    held : list of inputs
        Of another time.
    """
    numbers = [(plain_key(key), number) for key, number in news.names.numbers.items()]
    base = replay.base
    snapshot = SnapshotForm(
        version=VERSION,
        config=asdict(config),
        newest=clock.newest if math.isfinite(clock.newest) else None,
        elsewhere=clock.elsewhere,
        base=BaseForm(
            time=base.time,
            tracks=[plain_track(track) for track in base.tracks],
            joints=[plain_joint(joint) for joint in base.joints],
            ended=[(plain_key(key), reason) for key, reason in base.ended],
        ),
        odometry=[plain_odometry(sample) for sample in replay.path],
        looks=[
            LookForm(time=look.time, measurements=[plain_measured(one.source) for one in look.observations])
            for look in replay.looks
        ],
        held=[plain_held(one) for one in held],
        news=NewsForm(
            numbers=numbers,
            following=news.names.following,
            fates=[(time, order, *told) for (time, order), told in news.fates.items()],
            statuses=list(news.statuses.items()),
            renewed=sorted(news.renewed),
        ),
        latency=plain_watch(watch),
    )
    return snapshot.model_dump(mode="json")


def read_config(snapshot: Mapping[str, Any]) -> TrackerConfig:
    """Return the parameters of a snapshot.

    Raises
    ------
    SnapshotError
        If it is malformed, of another version, or has other parameters than this one knows.
    """
    given = _checked(snapshot).config
    try:
        config = TypeAdapter(TrackerConfig).validate_python(given)
    except ValidationError as error:
        raise _fault(error, "config.") from None
    if asdict(config) != given:
        raise SnapshotError("snapshot: config: expected the parameters of this version, and no others")
    return config


def restored(
    snapshot: Mapping[str, Any],
    config: TrackerConfig,
    clock: Clock,
    replay: Replay,
    news: News,
    watch: LatencyWatch,
) -> list[Input]:
    """Put a snapshot's memory into a new tracker's parts.

    Returns
    -------
    list of inputs
        Those that are held.

    Raises
    ------
    SnapshotError
        If something in it cannot be used.
    """
    plain = _checked(snapshot)
    clock.newest = -math.inf if plain.newest is None else plain.newest
    clock.elsewhere = list(plain.elsewhere)
    replay.base = _base(plain.base)
    try:
        for sample in plain.odometry:
            replay.path.put(as_odometry(sample))
        for look in plain.looks:
            replay.place(Look(look.time, tuple(as_observations(look.measurements, config))))
        held = [as_held(one, config) for one in plain.held]
    except PalletLocError as error:
        raise SnapshotError(f"snapshot: {error}") from None
    replay.run()
    restore_watch(plain.latency, watch)
    told = plain.news
    news.names = Names({as_key(key): number for key, number in told.numbers}, told.following)
    news.fates = {(time, order): (kind, number) for time, order, kind, number in told.fates}
    news.statuses = dict(told.statuses)
    news.renewed = set(told.renewed)
    believed = {track.key for belief in (replay.base, *replay.beliefs) for track in belief.tracks}
    if not believed <= news.names.numbers.keys():
        raise SnapshotError("snapshot: news.numbers: expected a number for every track")
    return held


def _base(plain: BaseForm) -> Belief:
    """Return what was believed before the window."""
    try:
        joints = tuple(as_joint(joint) for joint in plain.joints)
    except ValueError as error:
        raise SnapshotError(f"snapshot: base.joints: {error}") from None
    known = [(key, state) for joint in joints for key, state in zip(joint.keys, joint.members, strict=True)]
    keys = [as_key(track.key) for track in plain.tracks]
    if sorted(key for key, _ in known) != sorted(keys):
        raise SnapshotError("snapshot: base.joints: expected every track in one of them")
    states = dict(known)
    tracks = tuple(as_track(track, states[key]) for key, track in zip(keys, plain.tracks, strict=True))
    ended = tuple((as_key(key), reason) for key, reason in plain.ended)
    return Belief(plain.time, tracks, joints, ended=ended)


def _checked(snapshot: Mapping[str, Any]) -> SnapshotForm:
    try:
        version = dict(snapshot).get("version")
    except (TypeError, ValueError):
        raise SnapshotError(f"snapshot: expected a mapping, got {type(snapshot).__name__}") from None
    if version != VERSION:
        raise SnapshotError(f"snapshot: version: expected {VERSION}, got {version!r}")
    try:
        return SnapshotForm.model_validate(dict(snapshot))
    except ValidationError as error:
        raise _fault(error) from None


def _fault(error: ValidationError, inside: str = "") -> SnapshotError:
    first = error.errors(include_url=False)[0]
    place = ".".join(str(step) for step in first["loc"])
    return SnapshotError(f"snapshot: {inside}{place}: {first['msg']}")
