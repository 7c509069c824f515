import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from palletloc.config import LocalizerConfig
from palletloc.io.config_file import _RANGES, field_meanings, format_config, read_config
from palletloc.io.reading import InputError
from palletloc.measurement import PalletMeasurement, Stage
from palletloc.paper.horizontal_view import BoundaryMethod

DEFAULT = LocalizerConfig()


def parameters(values: Any = DEFAULT, place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the place and value of every parameter."""
    for field in fields(values):
        value = getattr(values, field.name)
        if is_dataclass(value):
            yield from parameters(value, (*place, field.name))
        else:
            yield (*place, field.name), value


PARAMETERS = dict(parameters())


def nested(place: tuple[str, ...], value: Any) -> dict[str, Any]:
    for name in reversed(place):
        value = {name: value}
    return dict(value)


def value_at(config: Any, place: tuple[str, ...]) -> Any:
    for name in place:
        config = getattr(config, name)
    return config


def read(folder: Path, text: str) -> LocalizerConfig:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return read_config(path)


def another(value: Any) -> Any:
    """Return a value like the default, but not the same."""
    match value:
        case bool():
            return not value
        case StrEnum():
            return next(word for word in type(value) if word is not value)
        case int():
            return value + 1
        case float():
            return 0.9 * value
        case tuple():
            return tuple(0.9 * number for number in value)
    raise TypeError(type(value))


def changed(config: Any, place: tuple[str, ...], value: Any) -> Any:
    name, *rest = place
    return replace(config, **{name: changed(getattr(config, name), tuple(rest), value) if rest else value})


@settings(max_examples=25)
@given(st.sets(st.sampled_from(sorted(PARAMETERS))))
def test_whatever_is_changed_is_written_and_read_back(places: set[tuple[str, ...]]) -> None:
    config = DEFAULT
    for place in places:
        config = changed(config, place, another(PARAMETERS[place]))
    with TemporaryDirectory() as folder:
        assert read(Path(folder), format_config()) == DEFAULT
        assert read(Path(folder), format_config(config)) == config


@pytest.mark.parametrize("place", PARAMETERS, ids=".".join)
def test_a_file_overrides_what_it_names_and_nothing_else(tmp_path: Path, place: tuple[str, ...]) -> None:
    value = another(PARAMETERS[place])
    plain = str(value) if isinstance(value, StrEnum) else list(value) if isinstance(value, tuple) else value
    config = read(tmp_path, yaml.safe_dump(nested(place, plain)))
    assert value_at(config, place) == value
    assert type(value_at(config, place)) is type(PARAMETERS[place])
    assert changed(config, place, PARAMETERS[place]) == DEFAULT


@pytest.mark.parametrize("place", PARAMETERS, ids=".".join)
def test_every_parameter_is_written_below_its_meaning(place: tuple[str, ...]) -> None:
    text = format_config()
    *sections, name = place
    for depth, section in enumerate(sections):
        text = text[text.index(f"\n{'  ' * depth}{section}:\n") + 1 :]
    indent, lines = "  " * len(sections), text.splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith(f"{indent}{name}: "))
    assert lines[row - 1].startswith(f"{indent}# ")
    assert len(lines[row - 1]) > len(indent) + 8


def test_a_choice_is_written_with_what_it_can_be_and_lines_fit_a_terminal() -> None:
    text = " ".join(format_config().replace("#", "").split())
    assert all(f"- {word}: " in text for word in BoundaryMethod)
    assert max(map(len, format_config().splitlines())) <= 100


def test_only_a_value_that_is_not_the_default_names_the_default() -> None:
    assert "[default: " not in format_config()
    mine = changed(DEFAULT, ("detection", "max_range"), 4.25)
    lines = format_config(mine).splitlines()
    assert [line for line in lines if "[default: " in line] == [lines[lines.index("  max_range: 4.25") - 1]]
    assert f"[default: {DEFAULT.detection.max_range}]" in lines[lines.index("  max_range: 4.25") - 1]


def test_any_way_to_write_a_number_is_read(tmp_path: Path) -> None:
    for text in ("1e-3", "0.001", "1.0e-3"):
        assert read(tmp_path, f"face_fit: {{small_motion: {text}}}").face_fit.small_motion == 0.001
    assert read(tmp_path, "detection: {max_range: 4}").detection.max_range == 4.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("detectoin: {}", "unknown key 'detectoin'; did you mean 'detection'?"),
        ("detection: {max_rnge: 4}", "detection: unknown key 'max_rnge'; did you mean 'max_range'?"),
        ("max_range: 4", "unknown key 'max_range'; known are "),
        ("detection: {max_range: .nan}", "detection.max_range: expected a finite number, got nan"),
        ("detection: {max_range: -.inf}", "detection.max_range: expected a finite number, got -inf"),
        ("detection: {max_range: far}", "detection.max_range: expected a finite number, got 'far'"),
        ("detection: {max_range: true}", "detection.max_range: expected a finite number, got True"),
        ("detection: {max_range: [4]}", "detection.max_range: expected a finite number, got [4]"),
        ("detection: {max_range:}", "detection.max_range: expected a finite number, got None"),
        ("detection: {max_range: 4500}", "detection.max_range: expected a number from 0.5 to 20, got 4500"),
        ("detection: {resolution: 0}", "detection.resolution: expected a number from 0.001 to 0.05, got 0"),
        ("yaw: {max_turn_deg: -1}", "yaw.max_turn_deg: expected a number from 0 to 180, got -1"),
        ("prior: {level_sigma: 0}", "prior.level_sigma: expected a number from 0.0001 to 10, got 0"),
        ("verification: {certain: 1.5}", "verification.certain: expected a number from 0 to 1, got 1.5"),
        ("detection: {heights: [2, 1]}", "detection.heights: expected the lower number first, got [2, 1]"),
        ("detection: {heights: [0]}", "detection.heights: expected 2 finite numbers, got [0]"),
        ("detection: {heights: [0, 99]}", "detection.heights: expected numbers from -10 to 20, got [0, 99]"),
        ("detection: {heights: 3}", "detection.heights: expected 2 finite numbers, got 3"),
        ("face_fit: {iterations: 2.5}", "face_fit.iterations: ... got 2.5"),
        ("face_fit: {iterations: true}", "face_fit.iterations: ... got True"),
        ("face_fit: {iterations: 0}", "face_fit.iterations: expected a number from 1 to 100, got 0"),
        ("joint_search: {turns: 1}", "joint_search.turns: expected a number from 2 to 200, got 1"),
        ("yaw: {boundary: edge}", "yaw.boundary: ... got 'edge'"),
        ("yaw: 3", "yaw: expected a mapping, got 3"),
        ("[1]", "expected the keys prior, "),
        ("", "expected the keys prior, "),
        ("yaw: {}\nyaw: {}", "is not yaml: key 'yaw' stands there twice"),
        ("a: b: c", "is not yaml: "),
    ],
)
def test_a_bad_file_is_one_line_with_file_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "mine.yaml"))
    assert all(part in message for part in said.split("..."))
    assert "\n" not in message


def test_a_file_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: no such file"):
        read_config(tmp_path / "none.yaml")


def test_every_range_belongs_to_a_parameter() -> None:
    names = {place[-1] for place in PARAMETERS}
    unused = {pattern for pattern, *_ in _RANGES if not any(fnmatchcase(name, pattern) for name in names)}
    assert unused == set()


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


def test_each_field_and_each_member_has_the_text_below_it_on_one_line() -> None:
    assert field_meanings(Sample) == {"first": "One line.", "second": "Two lines.", "after": "Not of the one before."}
    assert field_meanings(Word) == {"ONE": "The first."}
    assert set(field_meanings(Stage)) == set(Stage.__members__)
    assert list(field_meanings(PalletMeasurement)) == [field.name for field in fields(PalletMeasurement)]


def test_a_class_without_source_has_no_meanings(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("made_of_nothing")
    monkeypatch.setitem(sys.modules, "made_of_nothing", module)
    monkeypatch.setattr(Sample, "__module__", "made_of_nothing")
    assert field_meanings(Sample) == {}
    monkeypatch.setattr(Sample, "__module__", "never_imported")
    assert field_meanings(Sample) == {}
