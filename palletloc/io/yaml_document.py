"""Strict reading and writing of yaml files through pydantic models; an error names file and key."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from palletloc.errors import nearest_name
from palletloc.io.atomic import write_text
from palletloc.io.csv_table import shortened
from palletloc.io.reading import InputError, read_text
from palletloc.plain_yaml import YamlError, is_other_base, load_plain, number_hint
from palletloc.ranges import out_of_range

_LENGTHS = {"min_length": "least", "max_length": "most"}
"""What the validator calls bounds of a length, and what a message calls them."""


class DocumentError(InputError):
    """A yaml file that does not hold what it should; names file and key, or file and line."""


class Document(BaseModel):
    """A mapping in a yaml file: an unknown key is an error that names the nearest known one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _know_all_keys(cls, given: Any) -> Any:
        for key in given if isinstance(given, dict) else ():
            if key not in cls.model_fields:
                hint = nearest_name(str(key), cls.model_fields)
                shown = {"key": repr(key), "hint": hint}
                raise PydanticCustomError("unknown_key", "unknown key {key}{hint}", shown)
        return given


_Document = TypeVar("_Document", bound=Document)


class Numbers:
    """Validator of a fixed count of finite numbers (or of one, where the count is None).

    Parameters
    ----------
    count : int, optional
        How many numbers; None for a single one that is no list.
    positive, non_negative : bool
        What each number must be.
    """

    def __init__(self, count: int | None = None, *, positive: bool = False, non_negative: bool = False) -> None:
        self._count = count
        self._positive = positive
        self._non_negative = non_negative

    def __call__(self, given: Any) -> Any:
        """Return the numbers, or raise the error that says what was expected."""
        numbers = [given] if self._count is None else given
        if not isinstance(numbers, list | tuple) or len(numbers) != (self._count or 1):
            raise self._fault(given)
        checked = tuple(self._checked(number, given) for number in numbers)
        return checked[0] if self._count is None else checked

    def _checked(self, number: Any, given: Any) -> float:
        try:
            # A yaml 1.1 parser takes "1e-3" for a text; a bool is a number to Python, not to a reader.
            refused = isinstance(number, bool) or (isinstance(number, str) and is_other_base(number))
            value = math.nan if refused else float(number)
        except (TypeError, ValueError, OverflowError):
            raise self._fault(given) from None
        if not math.isfinite(value) or (self._positive and value <= 0) or (self._non_negative and value < 0):
            raise self._fault(given)
        return value

    def _fault(self, given: Any) -> PydanticCustomError:
        kind = "positive " if self._positive else "non-negative " if self._non_negative else ""
        what = f"a finite {kind}number" if self._count is None else f"{self._count} finite {kind}numbers"
        hints = map(number_hint, given if isinstance(given, list) else [given])
        shown = {"what": what, "given": shortened(given), "hint": next(filter(None, hints), "")}
        return PydanticCustomError("numbers", "expected {what}, got {given}{hint}", shown)


def read_document(path: Path, schema: type[_Document]) -> _Document:
    """Read a yaml file and check it.

    Parameters
    ----------
    path : Path
        The file.
    schema : type of Document
        What it must hold.

    Returns
    -------
    Document
        An instance of the schema.

    Raises
    ------
    InputError
        If the file cannot be read.
    DocumentError
        If it is not yaml or does not hold what the schema says; names the line or the key.
    """
    return checked_document(path, load_yaml(path), schema)


def checked_document(path: Path, content: Any, schema: type[_Document]) -> _Document:
    """Check what a yaml file holds.

    Parameters
    ----------
    path : Path
        The file, for errors.
    content : any
        What was read from it.
    schema : type of Document
        What it must hold.

    Raises
    ------
    DocumentError
        If it does not hold what the schema says, or a number is out of its range; names the key.
    """
    if not isinstance(content, dict):
        keys = ", ".join(schema.model_fields)
        raise DocumentError(f"{path}: expected the keys {keys}, got {shortened(content)}")
    try:
        document = schema.model_validate(content)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        raise DocumentError(f"{path}: {_place(fault, content)}{_problem(fault)}") from None
    for place, problem in out_of_range("", document.model_dump()):
        raise DocumentError(f"{path}: {place.removeprefix('.')}: {problem}")
    return document


def load_yaml(path: Path) -> Any:
    """Return what a yaml file holds: plain values only, and no key twice; see `palletloc.plain_yaml`.

    Raises
    ------
    InputError
        If it cannot be read.
    DocumentError
        If it is not yaml; names the line.
    """
    try:
        return load_plain(read_text(path))
    except YamlError as fault:
        raise DocumentError(fault.of(path)) from None


def _place(fault: ErrorDetails, content: Any) -> str:
    """Return the key that a fault is about, as ``shelf.levels_m[1]: ``."""
    place = ""
    for step in fault["loc"]:
        if isinstance(step, int):
            place += f"[{step}]"
            content = content[step] if isinstance(content, list | tuple) and step < len(content) else None
            continue
        if isinstance(content, dict) and content.get("model") == step and step not in content:
            # Pydantic names the chosen member of a union too; in the file there is no such key.
            continue
        place += f".{step}" if place else step
        content = content.get(step) if isinstance(content, dict) else None
    return f"{place}: " if place else ""


def _problem(fault: ErrorDetails) -> str:
    """Return what is wrong there, and what was expected."""
    context = fault.get("ctx", {})
    match fault["type"]:
        case "missing":
            return "is missing"
        case "union_tag_not_found":
            return "expected a mapping with the key model"
        case "union_tag_invalid":
            known = [word.strip(" '") for word in context["expected_tags"].split(",")]
            return f"unknown model {shortened(context['tag'])}{nearest_name(context['tag'], known)}"
        case "model_type" | "model_attributes_type":
            return f"expected a mapping, got {shortened(fault['input'])}"
        case "unknown_key" | "numbers":
            return fault["msg"]
        case "tuple_type":
            return f"expected a list, got {shortened(fault['input'])}"
        case "too_short" | "too_long":
            bounds = [f"at {word} {context[key]}" for key, word in _LENGTHS.items() if key in context]
            return f"expected {' and '.join(bounds)} in the list, got {shortened(fault['input'])}"
    return f"{fault['msg'][:1].lower()}{fault['msg'][1:]}, got {shortened(fault['input'])}"


def format_document(document: Document) -> str:
    """Return a document as yaml text, keys in the schema's order, without those that are not set."""
    content = document.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)


def write_document(path: Path, document: Document) -> None:
    """Write a document as a yaml file, whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_text(path, format_document(document))
