"""The surveyed points of each body, found by their names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.survey.plan import FORKLIFT, SurveyPlan
from palletloc.survey.point import Survey, SurveyError, SurveyPoint


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedBody:
    """A body with the points that were surveyed on it."""

    name: str
    """Name of the body."""
    stop: str | None
    """Name of the stop for the forklift; None for a pallet."""
    places: FloatArray
    """(n, 3) places of the targets on the body, in metres."""
    points: tuple[SurveyPoint, ...]
    """The n surveyed points, in the same order."""
    missing: tuple[str, ...] = ()
    """Targets that the survey does not have."""

    @property
    def label(self) -> str:
        """The body as messages name it: ``body 'A'``, or ``stop 'S1'``."""
        return f"body '{self.name}'" if self.stop is None else f"stop '{self.stop}'"

    @property
    def world(self) -> FloatArray:
        """(n, 3) surveyed places, in metres."""
        return np.array([point.position for point in self.points])

    @property
    def lines(self) -> tuple[int, ...]:
        """First line of each point."""
        return tuple(point.lines[0] for point in self.points)

    def pairs(self) -> list[tuple[int, int]]:
        """Return every pair of its points, by index."""
        return list(combinations(range(len(self.points)), 2))

    def nominal(self) -> FloatArray:
        """Return the distance of each pair on the body, in metres."""
        return np.array([np.linalg.norm(self.places[i] - self.places[j]) for i, j in self.pairs()])

    def surveyed(self) -> FloatArray:
        """Return the distance of each pair as surveyed, in metres."""
        return np.array([np.linalg.norm(self.points[i].position - self.points[j].position) for i, j in self.pairs()])

    def with_points(self, points: Mapping[int, SurveyPoint]) -> SurveyedBody:
        """Return the body with some points replaced, by index."""
        return replace(self, points=tuple(points.get(index, point) for index, point in enumerate(self.points)))

    def without(self, index: int) -> SurveyedBody:
        """Return the body without one of its points."""
        kept = [other for other in range(len(self.points)) if other != index]
        return replace(self, places=self.places[kept], points=tuple(self.points[other] for other in kept))


def surveyed_bodies(plan: SurveyPlan, survey: Survey) -> tuple[list[SurveyedBody], list[str]]:
    """Find the points of the forklift at each stop and of each pallet.

    Parameters
    ----------
    plan : SurveyPlan
        The names.
    survey : Survey
        The points.

    Returns
    -------
    bodies : list of SurveyedBody
        The forklift at each stop, then the pallets.
    notes : list of str
        Targets that were not surveyed, and points that belong to no target.

    Raises
    ------
    SurveyError
        If fewer than two points of a body are in the survey, or one of them is unusable.
    """
    bodies: list[SurveyedBody] = []
    notes: list[str] = []
    used: set[str] = set()
    wanted = list(_wanted(plan))
    if not any(survey.find(name) for _, _, names in wanted for name in names):
        first = next(iter(wanted[0][2]))
        raise SurveyError(
            f"{survey.path}: has none of the points that {plan.path} names ('{first}' and others);"
            " is it the survey of another site?"
        )
    for body, stop, names in wanted:
        found = {name: point for name in names if (point := survey.find(name)) is not None}
        missing = tuple(name for name in names if name not in found)
        here = SurveyedBody(body, stop, np.array([names[name] for name in found]), tuple(found.values()), missing)
        if len(found) < 2:
            only = f"only {here.points[0].place}" if found else "no point"
            where = f", line {here.lines[0]}" if found else ""
            raise SurveyError(
                f"{survey.path}{where}: {here.label} has {only}; expected at least 2 of {', '.join(names)}"
                f"{rejected_text(survey)}"
            )
        if missing:
            notes.append(f"{survey.path}: {here.label} lacks {', '.join(missing)}")
        used.update(point.name for point in here.points)
        bodies.append(here)
    notes += [
        f"{survey.path}: {point.place} is no target" for point in survey.points.values() if point.name not in used
    ]
    return bodies, notes


def rejected_text(survey: Survey) -> str:
    """Return where missing points may have gone."""
    if not survey.rejected:
        return ""
    first = survey.rejected[0]
    return f" ({len(survey.rejected)} rejected lines, the first: line {first.line}: {first.text})"


def _wanted(plan: SurveyPlan) -> Iterator[tuple[str, str | None, dict[str, FloatArray]]]:
    """Yield each body and stop with the names its targets have in the survey."""
    for stop in plan.stops:
        targets = plan.bodies[FORKLIFT]
        yield FORKLIFT, stop.name, {f"{target}-{stop.name}": place for target, place in targets.items()}
    for pallet in plan.pallets:
        yield pallet, None, dict(plan.bodies[pallet])
