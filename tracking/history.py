"""Everything that was believed, step by step: what a smoother goes back through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tracking.belief import Belief
from tracking.joint import Joint
from tracking.track import Key, Track


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The tracks after one step: a shot, or a motion without one."""

    time: float
    """Of its end, in seconds."""
    tracks: Mapping[int, Track]
    """By their numbers."""
    joints: tuple[Joint, ...]
    """What is known of them together."""


class History:
    """Takes up the beliefs whose steps are final, with the numbers that their tracks had."""

    def __init__(self) -> None:
        self.final: list[Belief] = []
        """In the order of their times."""
        self._numbers: dict[Key, int] = {}
        self._named = 0

    def name(self, numbers: Mapping[Key, int]) -> None:
        """Take note of the numbers of tracks in beliefs that have come since."""
        for belief in self.final[self._named :]:
            self._numbers |= {track.key: numbers[track.key] for track in belief.tracks}
        self._named = len(self.final)

    def moments(self, latest: Sequence[Belief], numbers: Mapping[Key, int]) -> tuple[Moment, ...]:
        """Return all steps; looks that wait for odometry are none.

        Parameters
        ----------
        latest : sequence of Belief
            Those that are not final yet.
        numbers : mapping
            Numbers of their tracks.
        """
        known = {**self._numbers, **numbers}
        steps: list[Moment] = []
        for belief in (step for one in (*self.final, *latest) for step in (*one.via, one)):
            if belief.time is not None and not (steps and belief.time <= steps[-1].time):
                tracks = {known[track.key]: track for track in belief.tracks}
                steps.append(Moment(belief.time, tracks, belief.joints))
        return tuple(steps)
