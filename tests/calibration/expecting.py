"""What tests expect: a value that is there, and a command that refuses its input in one line."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

Value = TypeVar("Value")


def present(value: Value | None) -> Value:
    """Return a value that must be there."""
    assert value is not None
    return value


class Ran(NamedTuple):
    """How ``palletloc calibrate`` ended."""

    code: int
    out: str
    err: str

    def refuses(self, message: str) -> None:
        """Hold that the input was refused in one line that says this."""
        assert self.code == 1
        assert message in self.err
        assert self.err.count("\n") == 1


Calibrate = Callable[..., Ran]
"""Runs ``palletloc calibrate`` with these arguments."""
