"""The file truth/survey.yaml: which surveyed point is which target on which body, and when the forklift stood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from palletloc.geometry import FloatArray
from palletloc.io.schema import Number, Triple
from palletloc.io.yaml_document import Document, DocumentError, Numbers, read_document
from palletloc.survey.prism import PrismConstant, PrismConvention, PrismUse

FORKLIFT = "forklift"
"""Name of the body that moves."""


def _as_name(given: Any) -> Any:
    """Return a name; yaml takes one of digits only for a number."""
    return str(given) if isinstance(given, int) and not isinstance(given, bool) else given


def split_columns(given: Any) -> Any:
    """Return the names in a text with commas, ``P,E,N,H``."""
    return tuple(name.strip() for name in given.split(",")) if isinstance(given, str) else given


Name = Annotated[str, BeforeValidator(_as_name), Field(min_length=1)]
"""Name of a stop, a body or a target."""
Columns = Annotated[tuple[str, ...], BeforeValidator(split_columns), Field(min_length=4)]
"""What the columns of a table of points are, from the left: a list, or a text with commas."""
Sigma = Annotated[float, BeforeValidator(Numbers(positive=True))]
"""One standard deviation."""


class _StopSpec(Document):
    """A time at which the forklift stood still and was surveyed."""

    name: Name
    time_s: Number


class PrismSpec(Document):
    """Which prism stood on the points, where the instrument was set to another."""

    constant_mm: Number
    """Of the prism."""
    convention: PrismConvention = PrismConvention.LEICA
    set_mm: Number | None = None
    """What the instrument was set to; without it words 58 and 51 of the file tell."""
    set_convention: PrismConvention = PrismConvention.LEICA
    """Of `set_mm` and of the words."""


class _SurveySpec(Document):
    """The file survey.yaml."""

    file: Annotated[str, Field(min_length=1)]
    sigma_m: Sigma
    stops: Annotated[tuple[_StopSpec, ...], Field(min_length=1)]
    bodies: dict[Name, dict[Name, Triple]]
    level: bool = False
    prism: PrismSpec | None = None
    known: dict[Name, Triple] | None = None
    columns: Columns | None = None


@dataclass(frozen=True, slots=True)
class Stop:
    """A time at which the forklift stood still and was surveyed."""

    name: str
    """Its name: a target on the forklift is surveyed as TARGET-STOP."""
    time: float
    """When, in seconds."""


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """What was surveyed, and under which names."""

    path: Path
    """The file survey.yaml."""
    survey: Path
    """The file with the points."""
    sigma: float
    """Standard deviation of each surveyed coordinate, in metres."""
    stops: tuple[Stop, ...]
    """In the file's order."""
    bodies: Mapping[str, Mapping[str, FloatArray]]
    """For each body its targets, each (3,) in the body's own frame, in metres."""
    level: bool = False
    """Whether every body is taken to stand level, however many targets it has."""
    prism: PrismUse | None = None
    """Corrects the distances."""
    known: Mapping[str, FloatArray] | None = None
    """Points with known places, each (3,), from which free stations are found."""
    columns: tuple[str, ...] | None = None
    """What the columns of a table are, from the left; None where its header says so."""

    @property
    def pallets(self) -> tuple[str, ...]:
        """Names of the bodies that are not the forklift."""
        return tuple(body for body in self.bodies if body != FORKLIFT)


def read_survey_plan(path: Path) -> SurveyPlan:
    """Read a file survey.yaml.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    SurveyPlan
        With the path of the survey, which is relative to the file's folder.

    Raises
    ------
    InputError
        If the file is missing or wrong; names the key.
    """
    spec = read_document(path, _SurveySpec)
    for key in ("name", "time_s"):
        values = [getattr(stop, key) for stop in spec.stops]
        twice = next((value for value in values if values.count(value) > 1), None)
        if twice is not None:
            raise DocumentError(f"{path}: stops: {key} {twice} stands there twice")
    _check_bodies(path, spec.bodies)
    bodies = {body: {name: np.array(place) for name, place in some.items()} for body, some in spec.bodies.items()}
    stops = tuple(Stop(stop.name, stop.time_s) for stop in spec.stops)
    prism = prism_use(spec.prism) if spec.prism else None
    known = None if spec.known is None else {name: np.array(place) for name, place in spec.known.items()}
    return SurveyPlan(
        path, path.parent / spec.file, spec.sigma_m, stops, bodies, spec.level, prism, known, spec.columns
    )


def _check_bodies(path: Path, bodies: Mapping[str, Mapping[str, object]]) -> None:
    if FORKLIFT not in bodies:
        raise DocumentError(f"{path}: bodies: no body '{FORKLIFT}', got {', '.join(bodies) or 'none'}")
    if len(bodies) == 1:
        raise DocumentError(f"{path}: bodies: expected at least one pallet beside '{FORKLIFT}'")
    owner: dict[str, str] = {}
    for body, targets in bodies.items():
        if len(targets) < 2:
            raise DocumentError(f"{path}: bodies.{body}: has {len(targets)} targets, expected at least 2")
        for target in targets:
            if target in owner:
                raise DocumentError(f"{path}: bodies.{body}: target '{target}' is on '{owner[target]}' already")
            owner[target] = body


def prism_use(spec: PrismSpec) -> PrismUse:
    """Return how distances are corrected, from what a file says."""
    setting = None if spec.set_mm is None else PrismConstant(spec.set_mm / 1000, spec.set_convention)
    return PrismUse(PrismConstant(spec.constant_mm / 1000, spec.convention), setting, spec.set_convention)
