"""The one error family: what a command prints in one line before it exits with 1."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_DIGITS, _MOST_DIGITS = 6, 17
"""Digits of a time in a message; and how many tell any two numbers apart (IEEE 754, double)."""


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


def seconds(*times: float) -> tuple[str, ...]:
    """Return times as messages show them: in six digits, or in as many as tell them apart and two more.

    Parameters
    ----------
    *times : float
        In seconds.

    Examples
    --------
    >>> seconds(0.25, 3.0)
    ('0.25', '3')
    >>> seconds(1700000000.1, 1700000000.2)
    ('1700000000.1', '1700000000.2')
    """
    enough = next(
        (
            digits
            for digits in range(_DIGITS, _MOST_DIGITS)
            if len({f"{time:.{digits}g}" for time in times}) == len(set(times))
        ),
        _MOST_DIGITS,
    )
    digits = enough if enough == _DIGITS else min(enough + 2, _MOST_DIGITS)
    return tuple(f"{time:.{digits}g}" for time in times)
