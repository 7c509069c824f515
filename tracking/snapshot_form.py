"""The form of a snapshot: plain values for everything that a tracker keeps, and back.

Fields are named and measured as those of the classes that they stand for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.track_status import Status
from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.joint import Joint, joint_of, size_of
from tracking.motion import Twist
from tracking.observation import Observation, PartialMeasurement, observe
from tracking.odometry import Odometry, check_odometry
from tracking.shot_taken import ShotTaken
from tracking.state import Gaussian
from tracking.track import Key, Rival, Track

Input = Odometry | Observation | ShotTaken
"""What a tracker holds."""
Ten = Annotated[list[float], Field(min_length=10, max_length=10)]
"""A state."""
Four = tuple[float, float, float, float]
"""A pose."""


class _Plain(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class KeyForm(_Plain):
    """Name of a track."""

    time: float
    birth: str


class GaussianForm(_Plain):
    """A state with its covariance."""

    mean: Ten
    covariance: Annotated[list[Ten], Field(min_length=10, max_length=10)]


class RivalForm(_Plain):
    """What contradicts a track."""

    state: GaussianForm
    model: str
    hits: int


class JointForm(_Plain):
    """What is known of tracks together."""

    keys: Annotated[list[KeyForm], Field(min_length=1)]
    mean: list[float]
    covariance: list[list[float]]


class TrackForm(_Plain):
    """A track; its state is that in its estimate."""

    key: KeyForm
    model: str
    seen: float
    hits: int
    misses: int
    confirmed: bool
    nis: float | None
    ratios: list[float]
    rival: RivalForm | None


class BaseForm(_Plain):
    """What was believed before the window."""

    time: float | None
    tracks: list[TrackForm]
    joints: list[JointForm]
    ended: list[tuple[KeyForm, str]]


class OdometryForm(_Plain):
    """A sample of odometry."""

    kind: Literal["odometry"] = "odometry"
    time: float
    pose: Four | None
    twist: tuple[float, float, float] | None
    covariance: list[list[float]] | None


class WholeForm(_Plain):
    """A measured pose."""

    kind: Literal["pallet"] = "pallet"
    time: float
    model: str
    pose: Four
    covariance: list[list[float]]
    score: float
    yaw_from: YawSource
    file: str


class PartForm(_Plain):
    """A part of a measured pose."""

    kind: Literal["part"] = "part"
    time: float
    model: str
    components: list[str]
    values: list[float]
    covariance: list[list[float]]
    near: Four | None


class ShotForm(_Plain):
    """That a shot was taken."""

    kind: Literal["shot"] = "shot"
    time: float


HeldForm = OdometryForm | WholeForm | PartForm | ShotForm
MeasuredForm = Annotated[WholeForm | PartForm, Field(discriminator="kind")]


class LookForm(_Plain):
    """A shot with its measurements."""

    time: float
    measurements: list[MeasuredForm]


class NewsForm(_Plain):
    """What was told."""

    numbers: list[tuple[KeyForm, int]]
    following: int
    fates: list[tuple[float, str, EventKind, int | None]]
    statuses: list[tuple[int, Status]]
    renewed: list[tuple[float, int]]


class SnapshotBase(_Plain):
    """Everything."""

    version: Literal[2]
    config: dict[str, Any]
    newest: float | None
    elsewhere: list[float]
    base: BaseForm
    odometry: list[OdometryForm]
    looks: list[LookForm]
    held: list[Annotated[HeldForm, Field(discriminator="kind")]]
    news: NewsForm


def plain_key(key: Key) -> KeyForm:
    """Return the name of a track as plain values."""
    return KeyForm(time=key.time, birth=key.birth)


def as_key(plain: KeyForm) -> Key:
    """Return the name of a track."""
    return Key(plain.time, plain.birth)


def _gaussian(state: Gaussian) -> GaussianForm:
    return GaussianForm(mean=state.mean.tolist(), covariance=state.covariance.tolist())


def _as_gaussian(plain: GaussianForm) -> Gaussian:
    return Gaussian(np.array(plain.mean), np.array(plain.covariance))


def plain_track(one: Track) -> TrackForm:
    """Return a track as plain values."""
    rival = one.rival
    return TrackForm(
        key=plain_key(one.key),
        model=one.model,
        seen=one.seen,
        hits=one.hits,
        misses=one.misses,
        confirmed=one.confirmed,
        nis=None if math.isnan(one.nis) else one.nis,
        ratios=list(one.ratios),
        rival=None if rival is None else RivalForm(state=_gaussian(rival.state), model=rival.model, hits=rival.hits),
    )


def as_track(plain: TrackForm, state: Gaussian) -> Track:
    """Return a track in some state."""
    rival = plain.rival
    return Track(
        as_key(plain.key),
        plain.model,
        state,
        plain.seen,
        plain.hits,
        plain.misses,
        plain.confirmed,
        math.nan if plain.nis is None else plain.nis,
        tuple(plain.ratios),
        None if rival is None else Rival(_as_gaussian(rival.state), rival.model, rival.hits),
    )


def plain_joint(one: Joint) -> JointForm:
    """Return what is known of tracks together as plain values."""
    mean, covariance = one.state
    return JointForm(keys=[plain_key(key) for key in one.keys], mean=mean.tolist(), covariance=covariance.tolist())


def as_joint(plain: JointForm) -> Joint:
    """Return what is known of tracks together.

    Raises
    ------
    ValueError
        If it is not of the size of as many tracks.
    """
    size = size_of(len(plain.keys))
    if len(plain.mean) != size or [len(row) for row in plain.covariance] != [size] * size:
        raise ValueError(f"expected {size} numbers and their covariance for {len(plain.keys)} tracks")
    state = Gaussian(np.array(plain.mean), np.array(plain.covariance))
    return joint_of(tuple(as_key(key) for key in plain.keys), state)


def plain_odometry(sample: Odometry) -> OdometryForm:
    """Return a sample as plain values."""
    pose, twist, covariance = sample.pose, sample.twist, sample.covariance
    return OdometryForm(
        time=sample.time,
        pose=None if pose is None else _four(pose),
        twist=None if twist is None else (twist.forward, twist.left, twist.turn),
        covariance=None if covariance is None else covariance.tolist(),
    )


def as_odometry(plain: OdometryForm) -> Odometry:
    """Return a sample; raise a `BadInputError` if it cannot be used."""
    pose = None if plain.pose is None else LevelPose(*plain.pose)
    twist = None if plain.twist is None else Twist(*plain.twist)
    covariance = None if plain.covariance is None else np.array(plain.covariance)
    return check_odometry(Odometry(plain.time, pose, twist, covariance))


def plain_measured(source: PalletMeasurement | PartialMeasurement) -> WholeForm | PartForm:
    """Return a measurement as plain values."""
    covariance = np.asarray(source.covariance).tolist()
    if isinstance(source, PartialMeasurement):
        return PartForm(
            time=source.time,
            model=source.model,
            components=list(source.components),
            values=np.asarray(source.values).tolist(),
            covariance=covariance,
            near=None if source.near is None else _four(source.near),
        )
    return WholeForm(
        time=source.time,
        model=source.model,
        pose=_four(source.forklift_from_pallet),
        covariance=covariance,
        score=source.score,
        yaw_from=source.yaw_from,
        file=source.file,
    )


def _four(pose: LevelPose) -> Four:
    return pose.x, pose.y, pose.z, pose.yaw


def as_observations(plain: Sequence[WholeForm | PartForm], config: TrackerConfig) -> list[Observation]:
    """Return observations in their order.

    Raises
    ------
    BadInputError
        If one cannot be used.
    """
    found = []
    for one in observe([_as_measured(one) for one in plain], config.errors):
        if not isinstance(one, Observation):
            raise one
        found.append(one)
    return sorted(found, key=lambda one: one.order)


def _as_measured(plain: WholeForm | PartForm) -> PalletMeasurement | PartialMeasurement:
    covariance: FloatArray = np.array(plain.covariance)
    if isinstance(plain, PartForm):
        near = None if plain.near is None else LevelPose(*plain.near)
        return PartialMeasurement(
            plain.time, plain.model, tuple(plain.components), np.array(plain.values), covariance, near
        )
    pose = LevelPose(*plain.pose)
    return PalletMeasurement(plain.time, plain.model, pose, covariance, plain.score, plain.yaw_from, plain.file)


def plain_held(one: Input) -> HeldForm:
    """Return an input as plain values."""
    if isinstance(one, Odometry):
        return plain_odometry(one)
    return ShotForm(time=one.time) if isinstance(one, ShotTaken) else plain_measured(one.source)


def as_held(plain: HeldForm, config: TrackerConfig) -> Input:
    """Return an input; raise a `BadInputError` if it cannot be used."""
    if isinstance(plain, OdometryForm):
        return as_odometry(plain)
    return ShotTaken(plain.time) if isinstance(plain, ShotForm) else as_observations([plain], config)[0]
