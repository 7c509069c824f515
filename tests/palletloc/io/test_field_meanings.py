from __future__ import annotations

import sys
import types
from dataclasses import dataclass, fields
from enum import StrEnum

import pytest

from palletloc.io.field_meanings import field_meanings
from palletloc.measurement import PalletMeasurement, Stage


@dataclass(frozen=True, slots=True)
class Sample:
    """The class's own docstring."""

    first: int
    """One line."""
    second: float = 2.0
    """Two
    lines."""
    silent: str = ""
    after: str = ""
    """Not of the one before."""

    def method(self) -> None:
        """Say nothing of any field."""


class Word(StrEnum):
    """Members are assigned without a type."""

    ONE = "one"
    """The first."""


def test_each_field_has_the_text_below_it_on_one_line() -> None:
    assert field_meanings(Sample) == {
        "first": "One line.",
        "second": "Two lines.",
        "after": "Not of the one before.",
    }


def test_members_of_an_enumeration_have_theirs() -> None:
    assert field_meanings(Word) == {"ONE": "The first."}
    assert set(field_meanings(Stage)) == set(Stage.__members__)


def test_the_values_of_the_package_say_what_every_field_means() -> None:
    assert list(field_meanings(PalletMeasurement)) == [field.name for field in fields(PalletMeasurement)]


def test_a_class_without_source_has_no_meanings(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("made_of_nothing")
    monkeypatch.setitem(sys.modules, "made_of_nothing", module)
    monkeypatch.setattr(Sample, "__module__", "made_of_nothing")
    assert field_meanings(Sample) == {}
    monkeypatch.setattr(Sample, "__module__", "never_imported")
    assert field_meanings(Sample) == {}
