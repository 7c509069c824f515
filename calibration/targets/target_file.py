"""Targets as files describe them: the keys `charuco` and `tag`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from calibration.targets.targets import CharucoBoard, SingleTag, Target, TargetError, patterns
from palletloc.io.yaml_document import Document, DocumentError, Numbers

Positive = Annotated[float, BeforeValidator(Numbers(positive=True))]
"""One positive number."""
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
            target = CharucoBoard(
                board.columns, board.rows, board.square_m, board.marker_m, board.dictionary, board.first_id
            )
        case (None, TagSpec() as single):
            target = SingleTag(single.size_m, single.dictionary, single.id)
        case _:
            raise DocumentError(f"{where}: expected one of the keys charuco and tag")
    try:
        patterns(target)
    except TargetError as error:
        raise DocumentError(f"{where}: {error}") from error
    return target


def refuse_shared_ids(path: Path, targets: Mapping[str, Target]) -> None:
    """Check that every marker belongs to one target.

    Parameters
    ----------
    path : Path
        The file, for errors.
    targets : mapping of str to Target
        By name.

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
                    f"{path}: targets.{name}: has the marker {number} of {target.dictionary}, which {owner} has too;"
                    " expected every id once"
                )
