"""Measurements that no program of ours makes: the tracker holds out against them all the same."""

from typing import Any

from palletloc.measurement import PalletMeasurement


def unchecked(sound: PalletMeasurement, **changes: Any) -> PalletMeasurement:
    """Return a measurement with parts that it would refuse."""
    made = object.__new__(PalletMeasurement)
    for name in PalletMeasurement.__slots__:
        object.__setattr__(made, name, changes.get(name, getattr(sound, name)))
    return made
