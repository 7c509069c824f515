"""Pallets over time: takes odometry and measurements as they come, in any order, and knows where the pallets are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement
from palletloc.pallet import PalletModel
from tracking.association import Footprints
from tracking.belief import Belief, UpdateModel
from tracking.config import TrackerConfig
from tracking.event_log import EventLog
from tracking.events import Event, EventKind
from tracking.filter import GroupFilter
from tracking.latency import LatencyEstimate, LatencyWatch
from tracking.observation import Observation, PartialMeasurement, ShotTaken, observe
from tracking.odometry import Odometry, check_odometry
from tracking.odometry_errors import OdometryErrors, odometry_errors
from tracking.smoother import History, Moment
from tracking.snapshot import Parts, Ready, read_memory, restored, written
from tracking.track_state import TrackState, states_at
from tracking.validation import BadInputError, UnknownTrackError
from tracking.window import Clock, Window

Input = Odometry | PalletMeasurement | PartialMeasurement | ShotTaken
"""What a tracker takes."""


class PalletTracker:
    """Fuses the measurements of single shots with odometry: one steady, honest pose for each pallet.

    Reads no clock, starts no thread, draws no random number: the same inputs give the same states, in whatever
    order they arrive inside the window.

    Parameters
    ----------
    config : TrackerConfig, optional
        Parameters.
    models : iterable of PalletModel, optional
        The pallets of the site; measurements of others are rejected. If left out, every model's are taken.
    keep_history : bool
        Whether all that was believed is kept, to be smoothed at the end. Takes memory for every shot.

    Examples
    --------
    >>> import numpy as np
    >>> from palletloc.geometry import LevelPose
    >>> from palletloc.measurement import YawSource
    >>> tracker = PalletTracker()
    >>> for time in (0.0, 0.1):
    ...     events = tracker.push(Odometry(time, LevelPose(0.5 * time, 0.0, 0.0, 0.0)))
    >>> there = LevelPose(2.0, 1.8, 0.0, 1.57)
    >>> seen = PalletMeasurement(0.1, "epal1-1200", there, 1e-4 * np.eye(4), 0.9, YawSource.FACE)
    >>> [str(event.kind) for event in tracker.push(seen)]
    ['accepted', 'born']
    >>> for time in (0.2, 0.3):
    ...     events = tracker.push(Odometry(time, LevelPose(0.5 * time, 0.0, 0.0, 0.0)))
    >>> round(tracker.state(1).pose.x, 3)
    1.9
    """

    def __init__(
        self,
        config: TrackerConfig | None = None,
        models: Iterable[PalletModel] | None = None,
        *,
        keep_history: bool = False,
    ) -> None:
        self.config = config or TrackerConfig()
        self._model = UpdateModel(self.config, GroupFilter(self.config), Footprints(models))
        self._clock = Clock(self.config.window)
        self._history = History() if keep_history else None
        self._window = self._new_window()
        self._log = EventLog(self.config.life)
        self._latency = LatencyWatch(self.config)
        self._held: list[Ready] = []
        """Inputs from another time, until it is clear whether that is the present."""

    @property
    def newest(self) -> float | None:
        """Time of the newest input, in seconds; None before the first."""
        return self._clock.newest if math.isfinite(self._clock.newest) else None

    def push(self, given: Input | Iterable[Input]) -> list[Event]:
        """Take an input, or several.

        Parameters
        ----------
        given : Odometry, PalletMeasurement, PartialMeasurement, ShotTaken, or several of them
            In any order of time inside the window. A shot in which nothing was found is worth a `ShotTaken`, too:
            no pallet was seen then.

        Returns
        -------
        list of Event
            What became of the input, and what that led to; first what became of it.

        Raises
        ------
        TypeError
            If it is something else.
        """
        if isinstance(given, Input):
            return self._push((given,))
        inputs = tuple(given)
        for each in inputs:
            if not isinstance(each, Input):
                raise TypeError(f"expected odometry or a measurement, got {type(each).__name__}")
        return self._push(inputs)

    def state(self, track: int, at: float | None = None) -> TrackState:
        """Return where a pallet is.

        Parameters
        ----------
        track : int
            Its number, as the events name it.
        at : float, optional
            When, in seconds; the newest input's time if left out.

        Returns
        -------
        TrackState
            The pose in the forklift frame at that time, and how it is known.

        Raises
        ------
        UnknownTrackError
            If there is no such track, or it is not known so long ago.
        """
        for state in self.tracks(at):
            if state.track == track:
                return state
        known = ", ".join(str(state.track) for state in self.tracks()) or "none"
        when = "" if at is None else f" at {at:.6g} s"
        raise UnknownTrackError(f"track {track}{when}: expected one that lives then; now live: {known}")

    def tracks(self, at: float | None = None) -> tuple[TrackState, ...]:
        """Return where all pallets are that are followed.

        Parameters
        ----------
        at : float, optional
            When, in seconds; the newest input's time if left out.

        Returns
        -------
        tuple of TrackState
            In the order of their numbers.

        Raises
        ------
        UnknownTrackError
            If the time is not finite, or before what is kept.
        """
        time = self._clock.newest if at is None else at
        if self.newest is None:
            return ()
        if not math.isfinite(time):
            raise UnknownTrackError(f"tracks at {time!r} s: expected a finite time")
        belief = self._window.belief_at(time)
        if belief.time is None:
            return ()
        if time < belief.time:
            raise UnknownTrackError(f"tracks at {time:.6g} s: expected a time from {belief.time:.6g} s on")
        return states_at(time, belief, self._window.path, self._log.numbering.numbers, self._model)

    def odom_from_forklift(self, at: float) -> LevelPose | None:
        """Return where the forklift was by its odometry.

        Parameters
        ----------
        at : float
            When, in seconds.

        Returns
        -------
        LevelPose or None
            None where odometry does not reach that time, or its samples have no poses.
        """
        path = self._window.path
        return path.pose_at(at) if path.reaches(at) else None

    def history(self) -> tuple[Moment, ...]:
        """Return the tracks after every step so far, in the order of time.

        Raises
        ------
        ValueError
            If the tracker was not made to keep it.
        """
        if self._history is None:
            raise ValueError("the tracker was made without keep_history=True")
        return self._history.moments(self._window.beliefs, self._log.numbering.numbers)

    def _new_window(self) -> Window:
        return Window(self._model, Belief(), None if self._history is None else self._history.final)

    def latency(self) -> LatencyEstimate:
        """Return how much later than their exposure shots are stamped, by those of the last half minute.

        Shots count once they are older than the window. An event reports a latency that is significant or changes.

        Returns
        -------
        LatencyEstimate
            Beyond `MeasurementErrors.latency_s`; not observable where speed did not vary.
        """
        return self._latency.estimate()

    def odometry_errors(self) -> OdometryErrors:
        """Return what the live tracks have learnt of odometry's constant errors.

        Returns
        -------
        OdometryErrors
            Wheel scale and gyro bias with their covariance; with a track's end goes what it knew.
        """
        return odometry_errors([track.state for track in self._window.current.tracks], self.config)

    def snapshot(self) -> dict[str, Any]:
        """Return all that it knows as plain values that JSON knows, with its parameters.

        What is inside the window is kept as it came: `restore` does those steps again.
        """
        parts = Parts(self._clock, self._window, self._log, self._latency, self._held)
        return written(self.config, parts)

    @classmethod
    def restore(cls, snapshot: Mapping[str, Any], models: Iterable[PalletModel] | None = None) -> PalletTracker:
        """Return a tracker that goes on where another one was when its `snapshot` was taken.

        Parameters
        ----------
        snapshot : mapping
            As `snapshot` gave it, maybe by way of JSON.
        models : iterable of PalletModel, optional
            As that tracker had them; they are not part of it.

        Raises
        ------
        SnapshotError
            If it is malformed or of another version.
        """
        memory = read_memory(snapshot)
        tracker = cls(memory.config, models)
        tracker._clock, tracker._window, tracker._log, tracker._latency, tracker._held = restored(
            memory, tracker._model
        )
        return tracker

    def _push(self, inputs: Sequence[Input]) -> list[Event]:
        """Take inputs that come together: their steps are done once."""
        events: list[Event] = []
        changed = math.inf
        for given, ready in zip(inputs, self._checked(inputs), strict=True):
            taken, since = self._taken(given, ready)
            events += taken
            changed = min(changed, since)
        first = self._window.run(changed)
        events += self._log.of_steps(self._window, first)
        events += self._log.of_lives(self._window, self._clock.newest)
        events += self._latency.of_final(self._window, self._clock.horizon)
        final = self._window.forget_before(self._clock.horizon)
        if self._history is not None:
            self._history.record_numbers(self._log.numbering.numbers)
        return events + self._log.of_final(self._window, final)

    def _taken(self, given: Input, ready: Ready | BadInputError) -> tuple[list[Event], float]:
        """Return what became of an input, and from when on steps have to be done again."""
        if isinstance(ready, BadInputError):
            return [Event(EventKind.REJECTED, given.time, reason=str(ready))], math.inf
        arrival = self._clock.judge(ready.time)
        self._held = self._held[-arrival.follows :] if arrival.follows else []
        if not arrival.in_time:
            self._held = [*self._held, ready][-self.config.window.restart_inputs :]
            kind = EventKind.TIME_JUMP if arrival.jumped else EventKind.TOO_LATE
            window = self.config.window.window_s
            return [Event(kind, ready.time, age=arrival.age, window=window)], math.inf
        events = self._restarted(ready.time) if arrival.restarted else []
        since = math.inf
        for usable in (*self._held, ready):
            if self._clock.horizon <= usable.time <= self._clock.newest:
                if isinstance(usable, Odometry):
                    taken, changed = self._take_odometry(usable)
                else:
                    taken, changed = self._take_shot(usable), math.inf
                events += taken
                since = min(since, changed)
        self._held = []
        return events, since

    def _checked(self, inputs: Sequence[Input]) -> list[Ready | BadInputError]:
        """Return inputs ready to be used, or what is wrong with them; all measurements at once."""
        found: dict[int, Ready | BadInputError] = {}
        measured: dict[int, PalletMeasurement | PartialMeasurement] = {}
        for number, given in enumerate(inputs):
            try:
                if isinstance(given, Odometry):
                    found[number] = check_odometry(given)
                elif isinstance(given, ShotTaken):
                    found[number] = given.checked(self.config.errors.latency_s)
                else:
                    self._check_model(given)
                    measured[number] = given
            except BadInputError as fault:
                found[number] = fault
        ready = observe(list(measured.values()), self.config.errors)
        found.update(zip(measured, ready, strict=True))
        return [found[number] for number in range(len(inputs))]

    def _check_model(self, given: PalletMeasurement | PartialMeasurement) -> None:
        if not self._model.footprints.accepts(given.model):
            names = ", ".join(self._model.footprints.names)
            raise BadInputError("model", given.time, f"expected one of {names}, got {given.model!r}")

    def _take_odometry(self, sample: Odometry) -> tuple[list[Event], float]:
        path = self._window.path
        present = path.find(sample.time)
        if present is not None and present.contents >= sample.contents:
            reason = "" if present.contents == sample.contents else "another sample of the same time was kept"
            return [Event(EventKind.DUPLICATE, sample.time, reason=reason)], math.inf
        changed = path.put(sample)
        events = [Event(EventKind.ACCEPTED, sample.time)]
        if path.jumps_at(sample.time):
            events.append(Event(EventKind.RESET, sample.time, reason="the odometry's pose jumped"))
        return events, math.nextafter(changed, math.inf)

    def _take_shot(self, given: Observation | ShotTaken) -> list[Event]:
        if isinstance(given, ShotTaken):
            self._window.place(given.time)
            return [Event(EventKind.ACCEPTED, given.time)]
        return [] if self._window.place(given.time, given) else [Event(EventKind.DUPLICATE, given.time)]

    def _restarted(self, time: float) -> list[Event]:
        """Forget everything but the numbers given so far."""
        self._window = self._new_window()
        self._latency = LatencyWatch(self.config)
        return self._log.of_restart(time)
