"""Frozen values as plain values that JSON knows, and back: walked by the annotations of their fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray
from palletloc.measurement import PalletMeasurement
from tracking.observation import PartialMeasurement, ShotTaken
from tracking.odometry import Odometry

LARGEST = 1e30
"""Largest number that is read: beyond all that checked inputs lead to, and small enough to be squared."""
KINDS = {kind: kind.__name__ for kind in (Odometry, PalletMeasurement, PartialMeasurement, ShotTaken)}
"""Inputs, of which any may stand in one place, with the names that tell them from each other."""
_NAMES: dict[type, str] = {bool: "true or false", int: "a whole number", str: "a text"}
"""How messages name the types of JSON."""


class SnapshotError(PalletLocError):
    """A snapshot that cannot be restored; names the place in it."""


def plain_values(value: Any) -> Any:
    """Return a value as JSON knows it.

    Parameters
    ----------
    value : object
        A frozen dataclass, a named tuple, an array, a list or tuple of such, or a plain value.

    Returns
    -------
    dict, list, str, int, float, bool or None
        A mapping of its fields; with ``kind`` where one of several classes may stand in a place.
    """
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if is_dataclass(value):
        kind = {"kind": type(value).__name__} if type(value) in KINDS else {}
        return kind | {field.name: plain_values(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "_asdict"):
        return {name: plain_values(part) for name, part in value._asdict().items()}
    return [plain_values(part) for part in value]


def value_of(annotation: Any, plain: Any, place: str) -> Any:
    """Return the value that plain values stand for.

    Parameters
    ----------
    annotation : type
        Its type, as a field states it.
    plain : object
        As `plain_values` gave it, maybe by way of JSON.
    place : str
        Where it stands, for messages.

    Raises
    ------
    SnapshotError
        If a key is missing or unknown, or a value of another kind than expected; numbers must be finite.
    """
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return _one_of(parts, plain, place)
    if origin is np.ndarray:
        return _array(plain, place)
    if origin is tuple:
        return _tuple(parts, plain, place)
    if issubclass(annotation, Enum):
        return _member(annotation, plain, place)
    if is_dataclass(annotation) or hasattr(annotation, "_fields"):
        return _record(annotation, plain, place)
    if annotation is float:
        return _number(plain, place)
    if type(plain) is not annotation:
        raise fault(place, f"expected {_NAMES[annotation]}, got {shown(plain)}")
    if annotation is int and abs(plain) > LARGEST:
        raise fault(place, f"expected a number up to {LARGEST:g}")
    return plain


def _one_of(parts: Sequence[Any], plain: Any, place: str) -> Any:
    if plain is None and NoneType in parts:
        return None
    possible = [part for part in parts if part is not NoneType]
    if len(possible) == 1:
        return value_of(possible[0], plain, place)
    kinds = {KINDS[part]: part for part in possible}
    kind = plain.get("kind") if isinstance(plain, Mapping) else None
    if not isinstance(kind, str) or kind not in kinds:
        raise fault(f"{place}.kind", f"expected one of {', '.join(kinds)}, got {shown(kind)}")
    return value_of(kinds[kind], plain, place)


def _tuple(parts: Sequence[Any], plain: Any, place: str) -> tuple[Any, ...]:
    if not isinstance(plain, list | tuple):
        raise fault(place, f"expected a list, got {shown(plain)}")
    if parts[-1] is Ellipsis:
        parts = (parts[0],) * len(plain)
    if len(parts) != len(plain):
        raise fault(place, f"expected {len(parts)} values, got {len(plain)}")
    return tuple(
        value_of(part, each, f"{place}.{i}") for i, (part, each) in enumerate(zip(parts, plain, strict=True))
    )


def _member(annotation: type[Enum], plain: Any, place: str) -> Enum:
    known = {member.value: member for member in annotation}
    if not isinstance(plain, str) or plain not in known:
        raise fault(place, f"expected one of {', '.join(known)}, got {shown(plain)}")
    return known[plain]


@cache
def _hints(annotation: type) -> dict[str, Any]:
    return get_type_hints(annotation)


def _record(annotation: type, plain: Any, place: str) -> Any:
    if not isinstance(plain, Mapping):
        raise fault(place, f"expected a mapping, got {shown(plain)}")
    hints, inside = _hints(annotation), f"{place}." if place else ""
    expected = {*hints, "kind"} if annotation in KINDS else {*hints}
    missing, unknown = sorted(expected - plain.keys()), sorted(map(str, plain.keys() - expected))
    if missing:
        raise fault(f"{inside}{missing[0]}", "is missing")
    if unknown:
        raise fault(f"{inside}{unknown[0]}"[:200], "is unknown")
    parts = {name: value_of(hint, plain[name], f"{inside}{name}") for name, hint in hints.items()}
    try:
        return annotation(**parts)
    except ValueError as error:
        raise fault(place, str(error)) from None


def _number(plain: Any, place: str) -> float:
    if type(plain) not in (float, int) or not abs(plain) <= LARGEST:
        raise fault(place, f"expected a finite number up to {LARGEST:g}, got {shown(plain)}")
    return float(plain)


def _array(plain: Any, place: str) -> FloatArray:
    """Return numbers, or rows of as many numbers each."""
    if not isinstance(plain, list | tuple):
        raise fault(place, f"expected a list of numbers, got {shown(plain)}")
    if not any(isinstance(row, list | tuple) for row in plain):
        return _row(plain, place)
    if len({len(row) if isinstance(row, list | tuple) else -1 for row in plain}) != 1:
        raise fault(place, "expected rows of as many numbers each")
    return np.array([_row(row, f"{place}.{i}") for i, row in enumerate(plain)])


def _row(plain: Sequence[Any], place: str) -> FloatArray:
    return np.array([_number(each, f"{place}.{i}") for i, each in enumerate(plain)], dtype=np.float64)


def fault(place: str, problem: str) -> SnapshotError:
    """Return the error of a place in a snapshot."""
    return SnapshotError(f"snapshot: {place}: {problem}" if place else f"snapshot: {problem}")


def shown(plain: Any) -> str:
    """Return a value for a message of one line."""
    if plain is None or isinstance(plain, bool | float | str):
        return repr(plain[:40] if isinstance(plain, str) else plain)
    if isinstance(plain, int):
        return repr(plain) if abs(plain) < LARGEST else "a larger one"
    return type(plain).__name__
