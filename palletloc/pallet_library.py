"""The pallet models that come along, and the reader and writer of ``pallets.yaml``.

The form of the file is described in ``docs/pallets.md``; the library's own file has the same form.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from palletloc.errors import PalletLocError, nearest_name
from palletloc.pallet import Opening, PalletModel
from palletloc.plain_yaml import YamlError, is_other_base, load_plain, number_hint

_NAME = re.compile(r"\w[\w.-]*")
"""What a model may be called: names become cells of csv files and names of files."""
_TOLERANCE: float = inspect.signature(PalletModel).parameters["tolerance"].default
"""Of a model's dimensions where nothing is stated, in metres."""
_MAX_LENGTH, _MAX_NESTING = 10.0, 10
"""Largest dimension that is believed, in metres: larger ones are millimetres. Deepest nesting of a file: three are
needed."""


class PalletFileError(PalletLocError):
    """A file of pallet models that cannot be read; the message names the file and the key or line."""


def _from_text(value: Any) -> Any:
    """Return a number written as text as a number: YAML 1.1 takes ``1e-3`` for text."""
    try:
        return float(value) if isinstance(value, str) and not is_other_base(value) else value
    except ValueError:
        return value


_Length = Annotated[float, Field(ge=-_MAX_LENGTH, le=_MAX_LENGTH), BeforeValidator(_from_text)]
_Row = Annotated[tuple[_Length, _Length], Field(strict=False)]  # YAML has lists only


class _Entry(BaseModel):
    """Its keys are the names of the fields of `Opening` and `PalletModel` with their unit."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _OpeningEntry(_Entry):
    center_m: _Length
    bottom_m: _Length
    width_m: _Length
    height_m: _Length
    radius_m: _Length = 0.0


class _ParametricEntry(_Entry):
    pocket_width_m: _Length
    center_width_m: _Length
    pocket_bottom_m: _Length
    pocket_height_m: _Length
    radius_m: _Length = 0.0


class _PalletEntry(_Entry):
    width_m: _Length
    height_m: _Length
    depth_m: _Length
    corner_radius_m: _Length = 0.0
    edge_radius_m: _Length = 0.0
    openings: list[_OpeningEntry] | None = None
    parametric: _ParametricEntry | None = None
    tolerance_m: _Length = _TOLERANCE
    source: str = ""
    confirmed: bool = False
    note: str = ""
    block_rows_m: Annotated[tuple[_Row, ...], Field(strict=False)] = ()


_PARTS: Mapping[str, type[_Entry]] = {"openings": _OpeningEntry, "parametric": _ParametricEntry}


def load_library() -> dict[str, PalletModel]:
    """Return the models that come along, in the order of the file.

    Returns
    -------
    dict of str to PalletModel
        By name; the caller's own.

    Examples
    --------
    >>> [opening.width for opening in load_library()["epal1-1200"].openings]
    [0.3825, 0.3825]
    """
    return dict(_library())


@cache
def _library() -> Mapping[str, PalletModel]:
    file = resources.files("palletloc").joinpath("pallets.yaml")
    return _parse(file.read_bytes(), "palletloc/pallets.yaml")


def read_pallets(path: str | Path) -> dict[str, PalletModel]:
    """Read pallet models measured by the user.

    Parameters
    ----------
    path : str or Path
        A ``pallets.yaml``.

    Returns
    -------
    dict of str to PalletModel
        By name, in the order of the file.

    Raises
    ------
    PalletFileError
        Where the file is missing or malformed, has an unknown, repeated or missing key, a value of the wrong
        kind or a face that cannot be built. One line names the file, the line or key, and what was expected.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise PalletFileError(f"{path}: {error.strerror}; expected a file of pallet models") from error
    return _parse(data, str(path))


def find_models(names: Iterable[str], user: Mapping[str, PalletModel]) -> tuple[PalletModel, ...]:
    """Look up models by name: the user's first, then those that come along.

    Parameters
    ----------
    names : iterable of str
        What to look up; a repeated name is looked up once.
    user : mapping of str to PalletModel
        The user's models; one hides the library's of the same name.

    Returns
    -------
    tuple of PalletModel
        In the order of the names.

    Raises
    ------
    PalletLocError
        For an unknown name; the message gives the nearest known one.

    Examples
    --------
    >>> [model.depth for model in find_models(["epal1-800", "epal1-1200"], user={})]
    [1.2, 0.8]
    """
    known, wanted = {**_library(), **user}, list(dict.fromkeys(names))
    for name in wanted:
        if name not in known:
            raise PalletLocError(f"unknown pallet model '{name}'{nearest_name(name, known)}")
    return tuple(known[name] for name in wanted)


def format_pallets(models: Iterable[PalletModel]) -> str:
    """Return models as the text of a ``pallets.yaml``, which `read_pallets` reads back unchanged.

    Parameters
    ----------
    models : iterable of PalletModel
        With different names.

    Returns
    -------
    str
        YAML. Keys that have their default value are left out.
    """
    entries = {}
    for model in models:
        openings = [_OpeningEntry(**_keys(opening, _OpeningEntry)) for opening in model.openings]
        entry = _PalletEntry(**_keys(model, _PalletEntry), openings=openings)
        entries[model.name] = entry.model_dump(exclude_defaults=True)
    return yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)


def _keys(value: Opening | PalletModel, entry: type[_Entry]) -> dict[str, Any]:
    """Return a file's keys for the fields of a value."""
    own = set(entry.model_fields) - set(_PARTS)
    return {key: getattr(value, key.removesuffix("_m")) for key in own}


def _fields(entry: _Entry) -> dict[str, Any]:
    """Return the fields of a value for a file's keys: the inverse of `_keys`."""
    dumped = entry.model_dump(exclude=set(_PARTS))
    return {key.removesuffix("_m"): value for key, value in dumped.items()}


def _parse(data: bytes, file: str) -> dict[str, PalletModel]:
    """Return the models of a file's content; ``file`` is for the messages."""
    content = _load_yaml(data, file)
    if content in (None, {}):
        raise PalletFileError(f"{file}: the file is empty; expected pallet models by name")
    if not isinstance(content, dict):
        raise PalletFileError(f"{file}: expected pallet models by name, got {_shown(content)}")
    return {name: _to_model(name, entry, file) for name, entry in content.items()}


def _to_model(name: object, content: object, file: str) -> PalletModel:
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise PalletFileError(
            f"{file}: {_shown(name)} is no name of a pallet model; expected letters, digits, '-', '_', '.'"
        )
    try:
        entry = _PalletEntry.model_validate(content)
    except ValidationError as error:
        raise PalletFileError(f"{file}: {_explain(error, name)}") from error
    openings = tuple(_openings(entry, f"{file}: {name}"))
    try:
        return PalletModel(name=name, openings=openings, **_fields(entry))
    except ValueError as error:
        raise PalletFileError(f"{file}: {name}: {error}") from error


def _openings(entry: _PalletEntry, where: str) -> Iterator[Opening]:
    """Yield the openings, listed or computed; ``where`` names the file and the model."""
    if (entry.openings is None) == (entry.parametric is None):
        got = "none" if entry.openings is None else "both"
        raise PalletFileError(f"{where}: expected one of the keys 'openings' and 'parametric', got {got}")
    listed = _two_pockets(entry.parametric) if entry.parametric else entry.openings or []
    for index, part in enumerate(listed):
        try:
            yield Opening(**_fields(part))
        except ValueError as error:
            place = "parametric" if entry.parametric else f"openings[{index}]"
            raise PalletFileError(f"{where}.{place}: {error}") from error


def _two_pockets(entry: _ParametricEntry) -> list[_OpeningEntry]:
    """Return the two equal openings beside a middle block."""
    offset = (entry.center_width_m + entry.pocket_width_m) / 2
    size = {"width_m": entry.pocket_width_m, "height_m": entry.pocket_height_m}
    shape = {"bottom_m": entry.pocket_bottom_m, "radius_m": entry.radius_m}
    return [_OpeningEntry(center_m=center, **size, **shape) for center in (-offset, offset)]


def _load_yaml(data: bytes, file: str) -> Any:
    """Return the content of one YAML document without repeated keys."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise PalletFileError(f"{file}, line {line}: expected text in UTF-8") from error
    try:
        return load_plain(text, tags=False, deepest=_MAX_NESTING)
    except YamlError as fault:
        raise PalletFileError(fault.of(file)) from None


def _explain(error: ValidationError, name: str) -> str:
    """Return the key and what was expected there, for the first of a model's errors."""
    details = error.errors(include_url=False, include_context=False)
    # A misspelt key comes first: it is the reason for a missing one.
    first = next((detail for detail in details if detail["type"] in _UNKNOWN_KEY), details[0])
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in first["loc"]]
    place = name + "".join(steps)
    if first["type"] == "missing":
        return f"{place}: the {'value' if place.endswith(']') else 'key'} is missing"
    if first["type"] in _UNKNOWN_KEY:
        known = _PARTS.get(str(first["loc"][0]), _PalletEntry).model_fields
        key = str(first["loc"][-1])
        return f"{name}{''.join(steps[:-1])}: unknown key '{key}'{nearest_name(key, known)}"
    given = first["input"]
    return f"{place}: expected {_EXPECTED.get(first['type'], first['msg'])}, got {_shown(given)}{number_hint(given)}"


_UNKNOWN_KEY = {"extra_forbidden", "invalid_key"}
"""Pydantic's names of the error that a key is not known."""
_EXPECTED = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "less_than_equal": f"metres, at most {_MAX_LENGTH:g}",
    "greater_than_equal": f"metres, at least {-_MAX_LENGTH:g}",
    "bool_type": "true or false",
    "string_type": "text",
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "too_long": "two numbers",
    "model_type": "a mapping of keys to values",
}
"""What was expected, by pydantic's name of the error."""


def _shown(value: object) -> str:
    """Return a value for a message: short, however large it is."""
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    if value is None:
        return "nothing"
    if isinstance(value, int) and abs(value) > 10**15:
        return "a huge number"
    shown = repr(value)
    return shown if len(shown) <= 40 else f"{shown[:37]}..."
