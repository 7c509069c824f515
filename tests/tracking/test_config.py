import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
import yaml

from palletloc.config import LocalizerConfig
from palletloc.io.config_file import OTHER_SECTIONS, format_config, read_config
from palletloc.io.reading import InputError
from tracking.config import RANGES, SECTION, TrackerConfig, format_tracker_config, read_tracker_config

DEFAULT = TrackerConfig()


def parameters(values: Any = DEFAULT, place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the place and value of every parameter."""
    for field in fields(values):
        value = getattr(values, field.name)
        if is_dataclass(value):
            yield from parameters(value, (*place, field.name))
        else:
            yield (*place, field.name), value


PARAMETERS = dict(parameters())


def changed(config: Any, place: tuple[str, ...], value: Any) -> Any:
    name, *rest = place
    return replace(config, **{name: changed(getattr(config, name), tuple(rest), value) if rest else value})


def another(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    return 0.9 * value if value else 0.05


def read(folder: Path, text: str) -> TrackerConfig:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return read_tracker_config(path)


def test_what_is_written_is_read_back_by_both_packages(tmp_path: Path) -> None:
    text = f"{format_config()}\n{format_tracker_config()}"
    assert read(tmp_path, text) == DEFAULT
    assert read_config(tmp_path / "mine.yaml") == LocalizerConfig()


@pytest.mark.parametrize("place", PARAMETERS, ids=".".join)
def test_a_file_overrides_what_it_names_and_nothing_else(tmp_path: Path, place: tuple[str, ...]) -> None:
    value = another(PARAMETERS[place])
    nested: Any = value
    for name in reversed(("tracker", *place)):
        nested = {name: nested}
    assert read(tmp_path, yaml.safe_dump(nested)) == changed(DEFAULT, place, value)
    written = format_tracker_config(changed(DEFAULT, place, value))
    assert read(tmp_path, written) == changed(DEFAULT, place, value)
    unwrapped = " ".join(written.replace("#", " ").split())
    assert unwrapped.count("[default: ") == 1


@pytest.mark.parametrize("place", PARAMETERS, ids=".".join)
def test_every_parameter_is_written_below_its_meaning(place: tuple[str, ...]) -> None:
    text = f"\n{format_tracker_config()}"
    *sections, name = ("tracker", *place)
    for depth, section in enumerate(sections):
        text = text[text.index(f"\n{'  ' * depth}{section}:\n") + 1 :]
    indent, lines = "  " * len(sections), text.splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith(f"{indent}{name}: "))
    assert lines[row - 1].startswith(f"{indent}# ")
    assert len(lines[row - 1]) > len(indent) + 2


def test_lines_fit_a_terminal() -> None:
    assert max(map(len, format_tracker_config().splitlines())) <= 100


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("trakcer: {}", "unknown key 'trakcer'; did you mean 'tracker'?"),
        ("tracker: {lief: {}}", "tracker: unknown key 'lief'; did you mean 'life'?"),
        (
            "tracker: {errors: {common_position: 1}}",
            "tracker.errors: unknown key 'common_position'; did you mean 'common_position_m'?",
        ),
        ("tracker: {window: {window_s: 0}}", "tracker.window.window_s: expected a number from 0.01 to 600, got 0"),
        ("tracker: {gate: {probability: 1}}", "tracker.gate.probability: expected a number from 0.5 to 0.999999"),
        ("tracker: {errors: {latency_s: .nan}}", "tracker.errors.latency_s: expected a finite number, got nan"),
        ("tracker: {errors: {latency_s: 40}}", "tracker.errors.latency_s: expected a number from -10 to 10, got 40"),
        ("tracker: {life: {confirm_hits: 0}}", "tracker.life.confirm_hits: expected a number from 1 to 100, got 0"),
        ("tracker: {life: {confirm_hits: 2.5}}", "tracker.life.confirm_hits: ... got 2.5"),
        ("tracker: {estimate_odometry: 1}", "tracker.estimate_odometry: ... got 1"),
        ("tracker: 3", "tracker: expected a mapping, got 3"),
        ("", "expected the keys tracker, "),
    ],
)
def test_a_bad_file_is_one_line_with_file_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "mine.yaml"))
    assert all(part in message for part in said.split("..."))
    assert "\n" not in message


def test_innovations_may_be_left_alone_and_shots_stamped_early(tmp_path: Path) -> None:
    config = read(tmp_path, "tracker: {gate: {adapt_over: 0}, errors: {latency_s: -0.02}}")
    assert (config.gate.adapt_over, config.errors.latency_s) == (0, -0.02)


def test_the_other_packages_section_is_passed_over(tmp_path: Path) -> None:
    assert SECTION in OTHER_SECTIONS
    assert read(tmp_path, "detection: {max_range: 4}") == DEFAULT
    assert read_config(tmp_path / "mine.yaml").detection.max_range == 4
    assert read(tmp_path, "tracker: {life: {confirm_hits: 4}}").life.confirm_hits == 4
    assert read_config(tmp_path / "mine.yaml") == LocalizerConfig()


def test_every_range_belongs_to_a_parameter_and_holds_its_default() -> None:
    names = {place[-1]: value for place, value in PARAMETERS.items()}
    unused = {pattern for pattern, *_ in RANGES if not any(fnmatchcase(name, pattern) for name in names)}
    assert unused == set()
    for name, value in names.items():
        _, low, high = next(limits for limits in RANGES if fnmatchcase(name, limits[0]))
        assert low <= value <= high
        assert math.isfinite(high)
