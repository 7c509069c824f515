"""Parameters in a yaml file: any part of them overrides the defaults, and all of them can be written.

The keys are the fields of `palletloc.config.LocalizerConfig` and of its parts. Beside them the file may have sections
of packages that build on this one; whoever reads the one passes over the other.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import yaml
from pydantic import AfterValidator, BeforeValidator, Field, create_model
from pydantic_core import PydanticCustomError

from palletloc.config import LocalizerConfig
from palletloc.io.yaml_document import Document, Numbers, read_document

_Config = TypeVar("_Config")

OTHER_SECTIONS = ("tracker",)
"""Keys at the top level that other packages read."""

Ranges = Sequence[tuple[str, float, float]]
"""Least and greatest value of each parameter, by its name; the first pattern that fits holds."""

_RANGES: Ranges = (
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
"""A guard against zero where it divides and against other units, far from values that make sense. Counts begin at 1
unless their own name stands there.
"""
_HEADER = (
    "Parameters of the localization. A file for --config may hold any part of this;"
    " what it leaves out keeps its default."
)
"""Comment at the top of a written file."""
_WIDTH = 100
"""Of a comment's lines, in characters."""


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
    return _built(LocalizerConfig, read_document(path, _whole(_schema(LocalizerConfig, _RANGES), OTHER_SECTIONS)))


def read_section(path: Path, name: str, kind: type[_Config], ranges: Ranges) -> _Config:
    """Read the parameters of another package from the same file.

    Parameters
    ----------
    path : Path
        A yaml file with nested keys.
    name : str
        One of `OTHER_SECTIONS`.
    kind : type
        A dataclass whose fields all have defaults, and may be such dataclasses themselves.
    ranges : Ranges
        Of its parameters.

    Returns
    -------
    dataclass
        The section's values, and the defaults of all others; the other sections are not looked at.

    Raises
    ------
    InputError
        As `read_config`.
    """
    part = _schema(cast(Any, kind), ranges)
    others = [*get_type_hints(LocalizerConfig), *(section for section in OTHER_SECTIONS if section != name)]
    keys: dict[str, Any] = {name: (part, Field(default_factory=part))}
    document = read_document(path, _whole(create_model(kind.__name__, __base__=Document, **keys), others))
    return _built(kind, getattr(document, name))


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


def format_section(name: str, values: Any, meaning: str) -> str:
    """Return a section of another package as text that may follow that of `format_config`.

    Parameters
    ----------
    name : str
        Its key.
    values : dataclass
        The values.
    meaning : str
        What it is, for the comment above the key.

    Returns
    -------
    str
        What `read_section` reads back unchanged.
    """
    lines = [*_comment(meaning, ""), f"{name}:", *_lines(values, type(values)(), "  ")]
    return "\n".join(lines) + "\n"


def _whole(part: type[Document], others: Iterable[str]) -> type[Document]:
    """Return what a file may say of which only a part is looked at."""
    keys: dict[str, Any] = dict.fromkeys(others, (Any, None))
    return create_model(part.__name__, __base__=part, **keys)


@cache
def _schema(kind: type[Any], ranges: Ranges) -> type[Document]:
    """Return what a file may say about a dataclass whose fields all have defaults."""
    defaults = kind()
    keys: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        default = getattr(defaults, name)
        if is_dataclass(default):
            part = _schema(cast(Any, type(default)), ranges)  # classes are hashable; their protocol does not say so
            keys[name] = (part, Field(default_factory=part))
        else:
            keys[name] = (_checked(name, hint, ranges), default)
    return create_model(kind.__name__, __base__=Document, **keys)


def _checked(name: str, hint: Any, ranges: Ranges) -> Any:
    """Return the type of a parameter with its checks."""
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return hint
    pattern, low, high = next(bounds for bounds in ranges if fnmatchcase(name, bounds[0]))
    if hint is float:
        return Annotated[float, BeforeValidator(Numbers()), AfterValidator(_Range(low, high))]
    if hint is bool:
        return Annotated[bool, Field(strict=True)]
    if hint is int:
        return Annotated[
            int, Field(strict=True), AfterValidator(_Range(low if pattern == name else max(low, 1), high))
        ]
    if get_origin(hint) is tuple and get_args(hint) == (float, float):
        return Annotated[hint, BeforeValidator(Numbers(2)), AfterValidator(_Range(low, high))]
    raise TypeError(f"{name}: a parameter of the type {hint} has no form in files")


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
            for member, text in field_meanings(type(value)).items():
                yield from _comment(f"- {type(value)[member]}: {text}", indent)
        yield f"{indent}{field.name}: {_scalar(value)}"


def _comment(text: str, indent: str) -> list[str]:
    later = "#   " if text.startswith("- ") else "# "
    return textwrap.wrap(text, _WIDTH, initial_indent=f"{indent}# ", subsequent_indent=indent + later)


def _scalar(value: Any) -> str:
    """Return a value as yaml on one line."""
    plain = list(value) if isinstance(value, tuple) else str(value) if isinstance(value, StrEnum) else value
    return yaml.safe_dump(plain, default_flow_style=True, width=1000).removesuffix("...\n").strip()


def field_meanings(kind: type) -> Mapping[str, str]:
    """Return what a class states about its fields or members.

    Parameters
    ----------
    kind : type
        A dataclass or an enumeration at the top level of its module.

    Returns
    -------
    mapping of str to str
        Docstring by name, on one line; empty where the source is not at hand.

    Examples
    --------
    >>> from palletloc.measurement import HeightPrior
    >>> field_meanings(HeightPrior)["sigma"]
    'Standard deviation, in metres.'
    """
    return _classes(kind.__module__).get(kind.__name__, {})


@cache
def _classes(module: str) -> Mapping[str, Mapping[str, str]]:
    """Return what the classes of a module say about their fields, by the class's name."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):  # no such module, or one without a source file
        return {}
    return {node.name: _meanings(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _meanings(node: ast.ClassDef) -> Mapping[str, str]:
    pairs = ((_assigned(statement), _text(follower)) for statement, follower in pairwise(node.body))
    return {name: text for name, text in pairs if name and text}


def _assigned(statement: ast.stmt) -> str:
    """Return the name that a statement gives a value or a type; empty where it does neither."""
    match statement:
        case ast.AnnAssign(target=ast.Name(id=name)) | ast.Assign(targets=[ast.Name(id=name)]):
            return name
    return ""


def _text(statement: ast.stmt) -> str:
    match statement:
        case ast.Expr(value=ast.Constant(value=str(text))):
            return " ".join(text.split())
    return ""
