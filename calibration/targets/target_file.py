"""Targets as files describe them: the keys `charuco` and `tag`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BeforeValidator, Field

from calibration.targets.targets import AprilGrid, CharucoBoard, SingleTag, Target, TargetError, patterns
from palletloc.io.yaml_document import Document, DocumentError, Numbers

Positive = Annotated[float, BeforeValidator(Numbers(positive=True))]
"""One positive number."""
_Printed = TypeVar("_Printed", bound=Target)
"""A kind of target."""
Count = Annotated[int, Field(strict=True, ge=0)]
"""A whole number that is not negative."""


class CharucoSpec(Document):
    """A ChArUco board."""

    columns: Annotated[int, Field(strict=True, ge=2)]
    rows: Annotated[int, Field(strict=True, ge=2)]
    square_m: Positive
    marker_m: Positive
    dictionary: str
    first_id: Count = 0


class TagSpec(Document):
    """A single ArUco or AprilTag marker."""

    dictionary: str
    id: Count
    size_m: Positive
    """Side of the black border's outer edge."""


class AprilGridSpec(Document):
    """Kalibr's grid of AprilTags."""

    columns: Annotated[int, Field(strict=True, ge=1)]
    rows: Annotated[int, Field(strict=True, ge=1)]
    tag_m: Positive
    """Side of a tag's black border."""
    spacing: Positive
    """Room between tags, as a part of their side."""
    first_id: Count = 0
    border_bits: Annotated[int, Field(strict=True, ge=1, le=4)] = 2
    """Width of the black border, in modules; Kalibr prints two."""


def april_grid(given: AprilGridSpec) -> AprilGrid:
    """Return the grid that a file describes; `checked_target` says whether such a grid can exist."""
    return AprilGrid(given.columns, given.rows, given.tag_m, given.spacing, given.first_id, given.border_bits)


def charuco_board(given: CharucoSpec) -> CharucoBoard:
    """Return the board that a file describes; `checked_target` says whether such a board can exist."""
    return CharucoBoard(given.columns, given.rows, given.square_m, given.marker_m, given.dictionary, given.first_id)


def checked_target(where: str, target: _Printed) -> _Printed:
    """Return a target as it was given; raises DocumentError, with its place in the file, if it cannot exist."""
    try:
        patterns(target)
    except TargetError as error:
        raise DocumentError(f"{where}: {error}") from error
    return target


def target_from_spec(path: Path, name: str, charuco: CharucoSpec | None, tag: TagSpec | None) -> Target:
    """Return what a file says is printed on a target.

    Parameters
    ----------
    path : Path
        The file, for errors.
    name : str
        Of the target.
    charuco, tag : optional
        One of them.

    Raises
    ------
    DocumentError
        If none or both are given, or such a target cannot exist.
    """
    where = f"{path}: targets.{name}"
    target: Target
    match (charuco, tag):
        case (CharucoSpec() as board, None):
            target = charuco_board(board)
        case (None, TagSpec() as single):
            target = SingleTag(single.size_m, single.dictionary, single.id)
        case _:
            raise DocumentError(f"{where}: expected one of the keys charuco and tag")
    return checked_target(where, target)


def refuse_shared_ids(path: Path, targets: Mapping[str, Target], key: str = "targets") -> None:
    """Check that every marker belongs to one target.

    Parameters
    ----------
    path : Path
        The file, for errors.
    targets : mapping of str to Target
        By name.
    key : str
        Where they stand in the file, for errors.

    Raises
    ------
    DocumentError
        If two targets have a marker in common.
    """
    owners: dict[tuple[str, int], str] = {}
    for name, target in targets.items():
        for number in patterns(target)[0].marker_ids:
            owner = owners.setdefault((target.dictionary, int(number)), name)
            if owner != name:
                raise DocumentError(
                    f"{path}: {key}.{name}: has the marker {number} of {target.dictionary}, which {owner} has too;"
                    " expected every id once"
                )
