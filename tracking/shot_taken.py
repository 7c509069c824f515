"""That a shot was taken, whatever was found in it."""

from __future__ import annotations

from dataclasses import dataclass

from tracking.faults import check_time


@dataclass(frozen=True, slots=True)
class ShotTaken:
    """A shot: without a measurement of a pallet in it, that pallet was not seen."""

    time: float
    """When it was exposed, in seconds."""

    def checked(self, latency: float) -> ShotTaken:
        """Return it with the time of the exposure.

        Parameters
        ----------
        latency : float
            How much later than the exposure it is stamped, in seconds.

        Raises
        ------
        BadInputError
            If its time is not finite.
        """
        check_time(self.time)
        return ShotTaken(self.time - latency)
