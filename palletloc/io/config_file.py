"""Parameters in a yaml file: any part of them overrides the defaults, and all of them can be written.

The keys are the fields of `palletloc.config.LocalizerConfig` and of its parts.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import yaml
from pydantic import AfterValidator, BeforeValidator, Field, create_model
from pydantic_core import PydanticCustomError

from palletloc.config import LocalizerConfig
from palletloc.io.field_meanings import field_meanings
from palletloc.io.yaml_document import Document, Numbers, read_document

_Config = TypeVar("_Config")

_RANGES: tuple[tuple[str, float, float], ...] = (
    ("hough_step_deg", 0.02, 10),
    ("*sigma_deg", 0.01, 90),
    ("*_deg", 0, 180),
    ("*_deg_s", 0, 180),
    ("*resolution", 0.001, 0.05),
    ("*_sigma", 0.0001, 10),
    ("min_score", 0, 1),
    ("min_coverage", 0, 1),
    ("min_rank", 0, 1),
    ("certain", 0, 1),
    ("reach", 0.002, 0.1),
    ("search", 0.02, 1),
    ("nearer", 0, 1),
    ("farther", 0, 1),
    ("sideways", 0, 1),
    ("upward", 0, 1),
    ("*_slack", 0, 1),
    ("*_depth", 0, 1),
    ("*_spacing", 0.01, 10),
    ("min_edges", 4, 100),
    ("turns", 2, 200),
    ("depths", 2, 200),
    ("heights", -10, 20),
    ("max_range", 0.5, 20),
    ("max_looks", 1, 10000),
    ("max_places", 1, 10000),
    ("*", 0, 100),
)
"""Least and greatest value of each parameter, by its name; the first pattern that fits holds.

A guard against zero where it divides and against other units, far from values that make sense. Counts begin
at 1.
"""
_HEADER = (
    "Parameters of the localization. A file for --config may hold any part of this;"
    " what it leaves out keeps its default."
)
_WIDTH = 100


def read_config(path: Path) -> LocalizerConfig:
    """Read parameters.

    Parameters
    ----------
    path : Path
        A yaml file with nested keys, such as ``detection: {max_range: 4.0}``.

    Returns
    -------
    LocalizerConfig
        The file's values, and the defaults of all others.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown (names the nearest), or a value is of the wrong kind or
        out of range; names the key.
    """
    return _built(LocalizerConfig, read_document(path, _schema(LocalizerConfig)))


def format_config(config: LocalizerConfig | None = None) -> str:
    """Return every parameter with its value and its meaning as the text of a yaml file.

    Parameters
    ----------
    config : LocalizerConfig, optional
        The values; the defaults if left out.

    Returns
    -------
    str
        What `read_config` reads back unchanged. Where a value is not the default, its comment names that.
    """
    lines = [*_comment(_HEADER, ""), "", *_lines(config or LocalizerConfig(), LocalizerConfig(), "")]
    return "\n".join(lines) + "\n"


def _schema(kind: type[Any]) -> type[Document]:
    """Return what a file may say about a dataclass whose fields all have defaults."""
    defaults = kind()
    keys: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        default = getattr(defaults, name)
        if is_dataclass(default):
            part = _schema(type(default))
            keys[name] = (part, Field(default_factory=part))
        else:
            keys[name] = (_checked(name, hint), default)
    return create_model(kind.__name__, __base__=Document, **keys)


def _checked(name: str, hint: Any) -> Any:
    """Return the type of a parameter with its checks."""
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return hint
    low, high = _range_of(name)
    if hint is float:
        return Annotated[float, BeforeValidator(Numbers()), AfterValidator(_Range(low, high))]
    if hint is bool:
        return Annotated[bool, Field(strict=True)]
    if hint is int:
        return Annotated[int, Field(strict=True), AfterValidator(_Range(max(low, 1), high))]
    if get_origin(hint) is tuple and get_args(hint) == (float, float):
        return Annotated[hint, BeforeValidator(Numbers(2)), AfterValidator(_Range(low, high))]
    raise TypeError(f"{name}: a parameter of the type {hint} has no form in files")


def _range_of(name: str) -> tuple[float, float]:
    return next((low, high) for pattern, low, high in _RANGES if fnmatchcase(name, pattern))


class _Range:
    """Validator of a number, or of a pair of numbers from lower to higher."""

    def __init__(self, low: float, high: float) -> None:
        self._low, self._high = low, high

    def __call__(self, given: Any) -> Any:
        numbers = given if isinstance(given, tuple) else (given,)
        if not all(self._low <= number <= self._high for number in numbers):
            what = "a number" if len(numbers) == 1 else "numbers"
            shown = {"what": what, "low": f"{self._low:g}", "high": f"{self._high:g}"}
            raise PydanticCustomError("range", "expected {what} from {low} to {high}", shown)
        if any(first >= second for first, second in pairwise(numbers)):
            raise PydanticCustomError("order", "expected the lower number first")
        return given


def _built(kind: type[_Config], document: Document) -> _Config:
    hints = get_type_hints(kind)
    values = {name: getattr(document, name) for name in hints}
    return kind(
        **{
            name: _built(hints[name], value) if isinstance(value, Document) else value
            for name, value in values.items()
        }
    )


def _lines(values: Any, defaults: Any, indent: str) -> Iterator[str]:
    """Yield the lines of a dataclass: a comment above each key."""
    meanings = field_meanings(type(values))
    for position, field in enumerate(fields(values)):
        value, default = getattr(values, field.name), getattr(defaults, field.name)
        meaning = meanings.get(field.name, "")
        if is_dataclass(value):
            yield from [""] * bool(position)
            yield from _comment(meaning, indent)
            yield f"{indent}{field.name}:"
            yield from _lines(value, default, indent + "  ")
            continue
        changed = "" if value == default else f" [default: {_scalar(default)}]"
        yield from _comment(meaning + changed, indent)
        if isinstance(value, StrEnum):
            for word, says in field_meanings(type(value)).items():
                yield from _comment(f"- {type(value)[word]}: {says}", indent)
        yield f"{indent}{field.name}: {_scalar(value)}"


def _comment(text: str, indent: str) -> list[str]:
    later = "#   " if text.startswith("- ") else "# "
    return textwrap.wrap(text, _WIDTH, initial_indent=f"{indent}# ", subsequent_indent=indent + later)


def _scalar(value: Any) -> str:
    """Return a value as yaml on one line."""
    plain = list(value) if isinstance(value, tuple) else str(value) if isinstance(value, StrEnum) else value
    return yaml.safe_dump(plain, default_flow_style=True, width=1000).removesuffix("...\n").strip()
