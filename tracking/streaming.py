"""The tracker's loop over odometry and shots as they arrive: the same live and from a recording."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from palletloc.cameras.protocol import CameraModel
from palletloc.errors import PalletLocError
from palletloc.geometry import Image, LevelPose
from palletloc.io.recording import Recording, ShotFile
from palletloc.localizer import Localizer
from palletloc.measurement import PalletMeasurement
from palletloc.mounting import Mounting
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
from tracking.events import Event, EventKind
from tracking.observation import ShotTaken
from tracking.odometry import Odometry, samples_of
from tracking.tracker import Input, PalletTracker

MOST_HELD = 32
"""How many shots may wait for odometry; before one more is held, the oldest of them is given up."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraShot:
    """A shot that nothing has been measured in yet."""

    time: float
    """When it was stamped, in seconds."""
    image: Image | Callable[[], Image]
    """(height, width) or (height, width, 3) array, gray or in blue-green-red order, or what loads it."""
    file: str = ""
    """Its name, for messages and results."""

    def load(self) -> Image:
        """Return the image."""
        return self.image() if callable(self.image) else self.image


class ShotLocalizer(Protocol):
    """What measures the pallets of a shot."""

    def localize(self, shot: CameraShot, odom_from_forklift: LevelPose) -> Sequence[PalletMeasurement]:
        """Return the pallets of a shot.

        Parameters
        ----------
        shot : CameraShot
            The shot.
        odom_from_forklift : LevelPose
            Where the forklift was by its odometry when it was taken.

        Raises
        ------
        PalletLocError, OSError
            If the shot cannot be used.
        """
        ...


@dataclass(slots=True, eq=False)
class ShelfLocalizer:
    """Measures the pallets on a shelf whose nominal front plane is known in odom."""

    localizer: Localizer
    """Finds pallets on a plane in the forklift frame."""
    camera: CameraModel
    """The camera."""
    mounting: Mounting
    """Where it sits on the forklift."""
    shelf: ShelfPlane
    """The plane, in odom."""
    start: float | None = None
    """When the plane was given, from which on the odometry drifts, in seconds; the first shot's time if left out."""

    def localize(self, shot: CameraShot, odom_from_forklift: LevelPose) -> Sequence[PalletMeasurement]:
        """Return the pallets of a shot; see `ShotLocalizer`."""
        if self.start is None:
            self.start = shot.time
        drift = self.localizer.config.prior.drift_after(shot.time - self.start)
        shelf = self.shelf.seen_from(odom_from_forklift, drift)
        return self.localizer.localize(Shot(shot.load(), self.camera, self.mounting, shot.time, shot.file), shelf)


@dataclass(frozen=True, slots=True, eq=False)
class RecordingSource:
    """A recording's odometry and shots in the order in which they would have arrived."""

    recording: Recording
    """The recording; an image is read when its shot is localized."""
    shot_delay: float = 0.0
    """How much later than its time each shot arrives, in seconds."""

    def __iter__(self) -> Iterator[Odometry | CameraShot]:
        """Yield samples and shots; of those that arrive together, the odometry first."""
        waiting = deque(self.recording.shots)
        for sample in samples_of(self.recording.odometry):
            while waiting and waiting[0].time + self.shot_delay < sample.time:
                yield self._shot(waiting.popleft())
            yield sample
        yield from map(self._shot, waiting)

    def _shot(self, shot: ShotFile) -> CameraShot:
        return CameraShot(shot.time, partial(self.recording.image, shot), shot.file)


def stream(source: Iterable[Input | CameraShot], localizer: ShotLocalizer, tracker: PalletTracker) -> Iterator[Event]:
    """Track pallets while odometry and shots arrive.

    Parameters
    ----------
    source : iterable of Odometry, CameraShot, or whatever else the tracker takes
        In the order of arrival, which need not be that of the times.
    localizer : ShotLocalizer
        Measures the pallets of a shot.
    tracker : PalletTracker
        Takes odometry and measurements; to be asked for its tracks after any event.

    Yields
    ------
    Event
        What became of every input. A shot that cannot be used, or that odometry never reaches, is rejected with the
        reason, and the stream goes on.

    Examples
    --------
    >>> import numpy as np
    >>> from palletloc.measurement import YawSource
    >>> class AlwaysThere:
    ...     def localize(self, shot, odom_from_forklift):
    ...         there = LevelPose(2.0 - odom_from_forklift.x, 1.8, 0.0, 1.57)
    ...         return [PalletMeasurement(shot.time, "t11", there, 1e-4 * np.eye(4), 0.9, YawSource.FACE)]
    >>> def drive():
    ...     for time in (0.0, 0.1, 0.2):
    ...         yield Odometry(time, LevelPose(0.5 * time, 0.0, 0.0, 0.0))
    ...         yield CameraShot(time, np.zeros((2, 4), np.uint8))
    >>> tracker = PalletTracker()
    >>> [str(event.kind) for event in stream(drive(), AlwaysThere(), tracker) if event.track]
    ['accepted', 'born', 'accepted', 'accepted', 'confirmed']
    >>> round(tracker.state(1).pose.x, 3)
    1.9
    """
    loop = _Loop(localizer, tracker)
    for given in source:
        if isinstance(given, CameraShot):
            yield from loop.take(given)
        else:
            yield from tracker.push(given)
            yield from loop.catch_up()
    yield from loop.give_up()


@dataclass(slots=True)
class _Loop:
    """Shots that wait until odometry reaches them."""

    localizer: ShotLocalizer
    tracker: PalletTracker
    held: list[CameraShot] = field(default_factory=list)

    def take(self, shot: CameraShot) -> Iterator[Event]:
        newest, window = self.tracker.newest, self.tracker.config.window.window_s
        if not math.isfinite(shot.time) or (newest is not None and newest - shot.time > window):
            yield from self.tracker.push(ShotTaken(shot.time))  # the tracker gives the reason
            return
        if self._pose(shot) is None:
            yield Event(EventKind.WAITING, shot.time, reason="no odometry at its time")
            if len(self.held) >= MOST_HELD:
                yield _unreached(self.held.pop(0))
        self.held.append(shot)
        yield from self.catch_up()

    def catch_up(self) -> Iterator[Event]:
        """Localize the shots that odometry has reached; give up those that it has passed without."""
        newest, window = self.tracker.newest, self.tracker.config.window.window_s
        waiting, self.held = self.held, []
        for shot in waiting:
            pose = self._pose(shot)
            if pose is not None:
                yield from self._localized(shot, pose)
            elif newest is not None and newest - shot.time > window:
                yield _unreached(shot)
            else:
                self.held.append(shot)

    def give_up(self) -> Iterator[Event]:
        """Reject what still waits at the end of the source."""
        waiting, self.held = self.held, []
        yield from map(_unreached, waiting)

    def _pose(self, shot: CameraShot) -> LevelPose | None:
        return self.tracker.odom_from_forklift(shot.time - self.tracker.config.errors.latency_s)

    def _localized(self, shot: CameraShot, odom_from_forklift: LevelPose) -> Iterator[Event]:
        try:
            found = self.localizer.localize(shot, odom_from_forklift)
        except (PalletLocError, OSError) as error:
            name = f"{shot.file}: " if shot.file and shot.file not in str(error) else ""
            yield Event(EventKind.REJECTED, shot.time, reason=f"{name}{error}")
            return
        yield from self.tracker.push([ShotTaken(shot.time), *found])


def _unreached(shot: CameraShot) -> Event:
    return Event(EventKind.REJECTED, shot.time, reason=f"{shot.file or 'shot'}: no odometry came for its time")
