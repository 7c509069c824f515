"""What every survey file comes to: named points, and a list of whatever could not be used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from palletloc.errors import nearest_name
from palletloc.geometry import FloatArray
from palletloc.io.reading import InputError
from palletloc.survey.polar import FaceErrors


class SurveyError(InputError):
    """A survey that does not hold what it should; names file, line and point."""


@dataclass(frozen=True, slots=True)
class LineNote:
    """A remark about one line of a file."""

    line: int
    """Number of the line, from 1."""
    text: str
    """What is wrong or worth knowing."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyPoint:
    """A surveyed point: the mean of all lines that give its place."""

    name: str
    """Its name in the file."""
    position: FloatArray
    """(3,) easting, northing and height, in metres."""
    lines: tuple[int, ...]
    """Where it stands in the file."""
    sight: FloatArray | None = None
    """(3,) unit vector from the instrument to it; None where the file does not give it."""

    @property
    def place(self) -> str:
        """The point as messages name it: ``point 'A-LL' (line 3)``."""
        return f"point '{self.name}' ({lines_text(self.lines)})"


@dataclass(frozen=True, slots=True)
class Survey:
    """The points of one survey file."""

    path: Path
    """The file."""
    points: Mapping[str, SurveyPoint]
    """By name."""
    rejected: tuple[LineNote, ...] = ()
    """Lines that could not be read, each with the reason."""
    notes: tuple[LineNote, ...] = ()
    """Lines that were read but not wholly used, each with the reason."""
    faces: tuple[FaceErrors, ...] = ()
    """Index and collimation errors, one for each pair of faces."""
    unusable: Mapping[str, str] = field(default_factory=dict)
    """Points that stand in the file but have no single place: the reason, by name."""

    def find(self, name: str) -> SurveyPoint | None:
        """Return a point, or None if the file does not have it; zeros before a name do not count.

        Raises
        ------
        SurveyError
            If the point is there but unusable.
        """
        for known in (name, name.lstrip("0") or "0"):
            if known in self.unusable:
                raise SurveyError(f"{self.path}, {self.unusable[known]}")
            if known in self.points:
                return self.points[known]
        return None

    def require(self, name: str) -> SurveyPoint:
        """Return a point.

        Raises
        ------
        SurveyError
            If it is not in the file (names the nearest) or unusable.
        """
        point = self.find(name)
        if point is None:
            raise SurveyError(f"{self.path}: no point '{name}'{nearest_name(name, self.points)}")
        return point

    def remarks(self) -> Iterator[str]:
        """Yield every rejected line and every note, as ``FILE, line N: text``."""
        for note in self.rejected:
            yield f"{self.path}, line {note.line}: rejected: {note.text}"
        for note in self.notes:
            yield f"{self.path}, line {note.line}: {note.text}"


def lines_text(lines: Sequence[int]) -> str:
    """Return ``line 3``, or ``lines 3 and 7``, or ``lines 3, 7 and 9``; of many, the first and the last."""
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > 4:
        return f"lines {lines[0]} to {lines[-1]}"
    return f"lines {', '.join(map(str, lines[:-1]))} and {lines[-1]}"
