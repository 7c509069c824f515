"""Prism constants and their two conventions.

A distance is right when the instrument's setting is the constant of the prism that stood on the point. Leica counts
constants from its own round prism, whose absolute constant is -34.4 mm; others count from the prism's geometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

_LEICA_OFFSET = 0.0344
"""Leica's constant minus the absolute one, in metres."""
LEICA_CONSTANTS: Mapping[str, float] = {
    "GPR1": 0.0,
    "GPR111": 0.0,
    "GPR121": 0.0,
    "GMP101": 0.0175,
    "GMP111": 0.0175,
    "GRZ4": 0.0231,
    "GRZ122": 0.0231,
    "tape": 0.0344,
    "reflectorless": 0.0344,
}
"""Constants in Leica's convention, in metres, as its manuals list them. Sources disagree on GRZ101: left out."""


class PrismConvention(StrEnum):
    """From where prism constants are counted."""

    LEICA = "leica"
    """From Leica's round prism: 0 for GPR1, +34.4 mm for tape."""
    ABSOLUTE = "absolute"
    """From the prism's geometry: -34.4 mm for GPR1, 0 for tape."""


@dataclass(frozen=True, slots=True)
class PrismConstant:
    """A prism constant with its convention."""

    value: float
    """In metres."""
    convention: PrismConvention = PrismConvention.LEICA
    """From where it is counted."""

    @property
    def leica(self) -> float:
        """The constant in Leica's convention, in metres.

        Examples
        --------
        >>> PrismConstant(-0.0344, PrismConvention.ABSOLUTE).leica
        0.0
        """
        return self.value + (_LEICA_OFFSET if self.convention is PrismConvention.ABSOLUTE else 0.0)

    @property
    def absolute(self) -> float:
        """The constant in the absolute convention, in metres."""
        return self.leica - _LEICA_OFFSET


@dataclass(frozen=True, slots=True)
class PrismUse:
    """Which prism stood on the points, and what the instrument was set to."""

    true: PrismConstant
    """Of the prism that was used."""
    setting: PrismConstant | None = None
    """What the instrument was set to; None for word 58 or 51 of each line, and zero where there is none."""
    words: PrismConvention = PrismConvention.LEICA
    """Convention of words 58 and 51."""

    def correction(self, word_value: float | None) -> float:
        """Return what has to be added to a measured distance.

        Parameters
        ----------
        word_value : float or None
            The constant that the line itself holds, in metres.

        Returns
        -------
        float
            In metres.
        """
        if self.setting is not None:
            setting = self.setting
        elif word_value is not None:
            setting = PrismConstant(word_value, self.words)
        else:
            setting = PrismConstant(0.0)
        return self.true.leica - setting.leica
