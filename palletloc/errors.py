"""The one error family: what a command prints in one line before it exits with 1."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class PalletLocError(Exception):
    """Bad input or an impossible request; the message says what, where, and what was expected."""


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return the closest of the known names, for the hint in an error about an unknown one.

    Parameters
    ----------
    name : str
        The unknown name.
    known : iterable of str
        The names that would have been understood.

    Returns
    -------
    str
        ``"; did you mean 'width_m'?"``, or the list of known names where none is close.

    Examples
    --------
    >>> nearest_name("widht_m", ["width_m", "height_m"])
    "; did you mean 'width_m'?"
    """
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known are {', '.join(names)}" if names else ""
