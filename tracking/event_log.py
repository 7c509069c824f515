"""The events of the tracker, each reported once: what became of measurements, and the lives of tracks by number."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from palletloc.track_status import Status
from tracking.belief import Belief, Disposition
from tracking.config import LifeConfig
from tracking.events import Event, EventKind
from tracking.state import Key
from tracking.window import ShotMeasurements, Window

Outcome = tuple[EventKind, int | None]
"""What was reported of a measurement, and the number of its track."""


class EventLog:
    """Remembers what was reported, and reports what is new or has changed.

    Parameters
    ----------
    config : LifeConfig
        When tracks coast and end.
    """

    def __init__(self, config: LifeConfig) -> None:
        self._config = config
        self.numbering = TrackNumbers()
        self.dispositions: dict[tuple[float, str], Outcome] = {}
        """What was reported of the measurements inside the window, by time and `Observation.order`."""
        self.statuses: dict[int, Status] = {}
        """What was reported of the live tracks, by their numbers."""
        self.renewed: set[tuple[float, int]] = set()
        """Shots and numbers of the tracks that were reported to begin anew."""

    def of_steps(self, window: Window, first: int) -> list[Event]:
        """Return what became of the observations of shots whose steps were done.

        Parameters
        ----------
        window : Window
            Shots and beliefs.
        first : int
            Index of the first such shot.
        """
        shots, beliefs = window.shots[first:], window.beliefs[first:]
        self.numbering.assign(shots, beliefs)
        events = []
        for shot, belief in zip(shots, beliefs, strict=True):
            for observation, disposition in zip(shot.observations, belief.dispositions, strict=True):
                events += self._disposition(shot.time, observation.order, disposition)
            for key in belief.renewed:
                number = self.numbering.numbers[key]
                if (shot.time, number) not in self.renewed:
                    self.renewed.add((shot.time, number))
                    reason = "its gate had rejected measurements that agree with each other"
                    events.append(Event(EventKind.REINITIALIZED, shot.time, number, reason=reason))
        return events

    def _disposition(self, time: float, order: str, disposition: Disposition) -> list[Event]:
        number = None if disposition.key is None else self.numbering.numbers.get(disposition.key)
        reported = self.dispositions.get((time, order))
        if reported == (disposition.kind, number):
            return []
        self.dispositions[time, order] = (disposition.kind, number)
        return [
            Event(
                disposition.kind,
                time,
                number,
                distance=disposition.distance,
                limit=disposition.limit,
                reason=disposition.reason,
                revised=reported is not None,
            )
        ]

    def of_lives(self, window: Window, newest: float) -> list[Event]:
        """Return which tracks began, were confirmed, coast or ended since the last report.

        Parameters
        ----------
        window : Window
            With what is believed now.
        newest : float
            The time now, in seconds.
        """
        believed = window.current
        numbers, reported = self.numbering.numbers, self.statuses
        events = []
        statuses: dict[int, Status] = {}
        for track in believed.tracks:
            if track.is_too_old(newest, self._config):
                continue
            number = numbers[track.key]
            statuses[number] = status = track.status(newest, self._config)
            before = reported.get(number)
            if before is status:
                continue
            if before is None:
                events.append(Event(EventKind.BORN, track.key.time, number))
            if status is not Status.TENTATIVE and before in (None, Status.TENTATIVE):
                events.append(Event(EventKind.CONFIRMED, track.seen, number))
            if status is Status.COASTING and before is not Status.COASTING:
                if believed.time == newest and before is not None:  # more of this shot may come
                    statuses[number] = before
                else:
                    events.append(Event(EventKind.COASTING, newest, number))
        gone = sorted(reported.keys() - statuses.keys())
        if gone:
            reasons = {numbers[key]: why for belief in window.beliefs for key, why in belief.ended if key in numbers}
        for number in gone:
            reason = reasons.get(number, "not seen for too long, or a late input explained it otherwise")
            events.append(Event(EventKind.LOST, newest, number, reason=reason))
        self.statuses = statuses
        return events

    def of_final(self, window: Window, final: Sequence[ShotMeasurements]) -> list[Event]:
        """Forget what cannot change any more; return which observations were never used.

        Parameters
        ----------
        window : Window
            After they were dropped from it.
        final : sequence of ShotMeasurements
            What was dropped.
        """
        if not final:
            return []
        events = []
        for shot in final:
            for observation in shot.observations:
                reported = self.dispositions.pop((shot.time, observation.order), None)
                if reported is not None and reported[0] is EventKind.WAITING:
                    reason = "no odometry came for its time"
                    events.append(Event(EventKind.REJECTED, shot.time, reason=reason, revised=True))
        oldest = window.shots[0].time if window.shots else final[-1].time
        self.renewed = {(time, number) for time, number in self.renewed if time >= oldest}
        if len(self.numbering.numbers) > len(window.current.tracks):  # others than those that live now
            self.numbering.keep(self._keys(window))
        return events

    def _keys(self, window: Window) -> set[Key]:
        beliefs = (window.base, *window.beliefs)
        living = {track.key for belief in beliefs for track in belief.tracks}
        return living | {key for belief in beliefs for key, _ in belief.ended}

    def of_restart(self, time: float) -> list[Event]:
        """Forget everything but which numbers were given; return what ends by that.

        Parameters
        ----------
        time : float
            The first one of the new time, in seconds.
        """
        events = [Event(EventKind.RESET, time, reason="all inputs come from another time: the tracker starts anew")]
        events += [Event(EventKind.LOST, time, number, reason="the tracker started anew") for number in self.statuses]
        self.numbering = TrackNumbers(following=self.numbering.following)
        self.dispositions.clear()
        self.statuses = {}
        self.renewed.clear()
        return events


class TrackNumbers:
    """Numbers of tracks by their keys.

    A late measurement may turn out to be a track's first one, which changes its key. The track then keeps the
    number that it had: it is the one that took up the former first measurement.
    """

    def __init__(self, numbers: dict[Key, int] | None = None, following: int = 1) -> None:
        self.numbers = dict(numbers or {})
        self.following = following

    def assign(self, shots: Sequence[ShotMeasurements], beliefs: Sequence[Belief]) -> None:
        """Give numbers to the tracks of beliefs that have been made or made again.

        Parameters
        ----------
        shots : sequence of ShotMeasurements
            Whose steps were done.
        beliefs : sequence of Belief
            What came of them.
        """
        present = {track.key for belief in beliefs for track in belief.tracks}
        fresh = sorted(present - self.numbers.keys())
        for key in fresh:
            heirs = [
                self.numbers[former]
                for former in self.numbers.keys() - present
                if _became(former, shots, beliefs) == key
            ]
            self.numbers[key] = min(heirs, default=0) or self._next()
        taken: set[int] = set()
        for key in sorted(present):
            if self.numbers[key] in taken:  # a former track is back beside the one that took it up
                self.numbers[key] = self._next()
            taken.add(self.numbers[key])

    def _next(self) -> int:
        self.following += 1
        return self.following - 1

    def keep(self, keys: Iterable[Key]) -> None:
        """Forget the numbers of all other tracks."""
        kept = set(keys)
        self.numbers = {key: number for key, number in self.numbers.items() if key in kept}


def _became(former: Key, shots: Sequence[ShotMeasurements], beliefs: Sequence[Belief]) -> Key | None:
    """Return the track to which the first measurement of another one went when the steps were done again."""
    for shot, belief in zip(shots, beliefs, strict=True):
        if shot.time == former.time:
            for observation, disposition in zip(shot.observations, belief.dispositions, strict=True):
                if observation.order == former.birth:
                    return disposition.key
    return None
