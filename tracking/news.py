"""What there is to tell after an input: the fates of measurements and the lives of tracks, each once."""

from __future__ import annotations

from collections.abc import Sequence

from palletloc.track_status import Status
from tracking.belief import Fate
from tracking.config import LifeConfig
from tracking.events import Event, EventKind
from tracking.naming import Names
from tracking.replay import Look, Replay
from tracking.track import Key

_Told = tuple[EventKind, int | None]


class News:
    """Remembers what was told, and tells what is new or has changed.

    Parameters
    ----------
    config : LifeConfig
        When tracks coast and end.
    """

    def __init__(self, config: LifeConfig) -> None:
        self._config = config
        self.names = Names()
        self.fates: dict[tuple[float, str], _Told] = {}
        self.statuses: dict[int, Status] = {}
        self.renewed: set[tuple[float, int]] = set()

    def of_steps(self, replay: Replay, first: int) -> list[Event]:
        """Return what became of the observations of looks whose steps were done.

        Parameters
        ----------
        replay : Replay
            Looks and beliefs.
        first : int
            Index of the first such look.
        """
        looks, beliefs = replay.looks[first:], replay.beliefs[first:]
        self.names.name(looks, beliefs)
        events = []
        for look, belief in zip(looks, beliefs, strict=True):
            for observation, fate in zip(look.observations, belief.fates, strict=True):
                events += self._fate(look.time, observation.order, fate)
            for key in belief.renewed:
                told = (look.time, self.names.numbers[key])
                if told not in self.renewed:
                    self.renewed.add(told)
                    reason = "its gate had rejected measurements that agree with each other"
                    events.append(Event(EventKind.REINITIALIZED, look.time, told[1], reason=reason))
        return events

    def _fate(self, time: float, order: str, fate: Fate) -> list[Event]:
        number = None if fate.key is None else self.names.numbers.get(fate.key)
        told = self.fates.get((time, order))
        if told == (fate.kind, number):
            return []
        self.fates[time, order] = (fate.kind, number)
        return [
            Event(
                fate.kind,
                time,
                number,
                distance=fate.distance,
                limit=fate.limit,
                reason=fate.reason,
                revised=told is not None,
            )
        ]

    def of_lives(self, replay: Replay, newest: float) -> list[Event]:
        """Return which tracks began, were confirmed, coast or ended since that was told last.

        Parameters
        ----------
        replay : Replay
            With what is believed now.
        newest : float
            The time now, in seconds.
        """
        believed = replay.current
        numbers, told = self.names.numbers, self.statuses
        events = []
        statuses: dict[int, Status] = {}
        for track in believed.tracks:
            if track.is_too_old(newest, self._config):
                continue
            number = numbers[track.key]
            statuses[number] = status = track.status(newest, self._config)
            before = told.get(number)
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
        gone = sorted(told.keys() - statuses.keys())
        if gone:
            reasons = {numbers[key]: why for one in replay.beliefs for key, why in one.ended if key in numbers}
        for number in gone:
            reason = reasons.get(number, "not seen for too long, or a late input explained it otherwise")
            events.append(Event(EventKind.LOST, newest, number, reason=reason))
        self.statuses = statuses
        return events

    def of_final(self, replay: Replay, final: Sequence[Look]) -> list[Event]:
        """Forget what cannot change any more; return which observations were never used.

        Parameters
        ----------
        replay : Replay
            After they were dropped from it.
        final : sequence of Look
            What was dropped.
        """
        if not final:
            return []
        events = []
        for look in final:
            for observation in look.observations:
                told = self.fates.pop((look.time, observation.order), None)
                if told is not None and told[0] is EventKind.WAITING:
                    reason = "no odometry came for its time"
                    events.append(Event(EventKind.REJECTED, look.time, reason=reason, revised=True))
        oldest = replay.looks[0].time if replay.looks else final[-1].time
        self.renewed = {told for told in self.renewed if told[0] >= oldest}
        if len(self.names.numbers) > len(replay.current.tracks):  # others than those that live now
            self.names.keep(self._keys(replay))
        return events

    def _keys(self, replay: Replay) -> set[Key]:
        beliefs = (replay.base, *replay.beliefs)
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
        self.names = Names(following=self.names.following)
        self.fates.clear()
        self.statuses = {}
        self.renewed.clear()
        return events
