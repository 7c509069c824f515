"""Numbers for tracks that stay the same, whatever late inputs do to the order of events."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tracking.belief import Belief
from tracking.replay import Look
from tracking.track import Key


class Names:
    """Numbers of tracks by their keys.

    A late measurement may turn out to be a track's first one, which changes its key. The track then keeps the
    number that it had: it is the one that took up the former first measurement.
    """

    def __init__(self, numbers: dict[Key, int] | None = None, following: int = 1) -> None:
        self.numbers = dict(numbers or {})
        self.following = following

    def name(self, looks: Sequence[Look], beliefs: Sequence[Belief]) -> None:
        """Give numbers to the tracks of beliefs that have been made or made again.

        Parameters
        ----------
        looks : sequence of Look
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
                if _became(former, looks, beliefs) == key
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


def _became(former: Key, looks: Sequence[Look], beliefs: Sequence[Belief]) -> Key | None:
    """Return the track to which the first measurement of another one went when the steps were done again."""
    for look, belief in zip(looks, beliefs, strict=True):
        if look.time == former.time:
            for observation, fate in zip(look.observations, belief.fates, strict=True):
                if observation.order == former.birth:
                    return fate.key
    return None
