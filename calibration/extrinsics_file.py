"""The file extrinsics.yaml: a camera, shots from a forklift that stands still, and surveyed targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from calibration.forklift_frame import ForkliftFrame
from calibration.network import Survey
from calibration.required_file import require_file
from calibration.survey_section import SurveySection, SurveySectionSpec, read_survey_section
from calibration.targets import CharucoBoard, SingleTag, Target, TargetError, patterns
from calibration.texture_alignment import on_board
from palletloc.cameras.protocol import CameraModel
from palletloc.errors import nearest_name
from palletloc.io.camera_spec import camera_from_spec
from palletloc.io.reading import InputError
from palletloc.io.schema import CameraSpec, Triple
from palletloc.io.yaml_document import Document, DocumentError, Numbers, read_document

EXTRINSICS = "extrinsics.yaml"
"""Name of the file in its folder."""
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


class CornersSpec(Document):
    """Surveyed corners of the printed pattern, seen from its front, in `forklift`."""

    top_left: Triple
    top_right: Triple
    bottom_left: Triple


class TargetSpec(Document):
    """One target: `charuco` or `tag`, and where it is."""

    charuco: CharucoSpec | None = None
    tag: TagSpec | None = None
    corners_m: CornersSpec | None = None
    """Not for a target that the section `survey` names."""
    sigma_m: Positive | None = None
    """Standard deviation of each surveyed coordinate."""


class ExtrinsicsSpec(Document):
    """The file extrinsics.yaml."""

    format: Literal[1]
    camera: CameraSpec
    shots: Annotated[tuple[str, ...], Field(min_length=1)]
    """Images, relative to the folder."""
    targets: Annotated[dict[str, TargetSpec], Field(min_length=1)]
    survey: SurveySectionSpec | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ExtrinsicsTask:
    """What the file says."""

    folder: Path
    """Where it is."""
    camera: CameraModel
    """The camera."""
    camera_spec: CameraSpec
    """The same, as files have it."""
    shots: tuple[str, ...]
    """Images, relative to the folder."""
    targets: dict[str, Target]
    """By name."""
    surveys: dict[str, Survey]
    """By name; in the forklift frame."""
    frame: ForkliftFrame | None = None
    """Where the forklift stood in the survey; None where the corners were given in its frame."""


def read_extrinsics(folder: Path) -> ExtrinsicsTask:
    """Read and check the file extrinsics.yaml of a folder; the shots stay in their files.

    Raises
    ------
    PalletLocError
        If the file or its survey is missing or wrong; names file, key and what was expected.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one with {EXTRINSICS} in it")
    path = require_file(folder / EXTRINSICS, "the camera, its shots and the surveyed targets")
    spec = read_document(path, ExtrinsicsSpec)
    try:
        camera = camera_from_spec(spec.camera)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from error
    targets = {name: target_from_spec(path, name, one.charuco, one.tag) for name, one in spec.targets.items()}
    refuse_shared_ids(path, targets)
    section = None if spec.survey is None else read_survey_section(path, spec.survey)
    unknown = next((name for name in (section.corners if section else ()) if name not in targets), None)
    if unknown is not None:
        raise DocumentError(f"{path}: survey.targets: unknown target '{unknown}'{nearest_name(unknown, targets)}")
    surveys = {name: _survey(path, name, targets[name], one, section) for name, one in spec.targets.items()}
    frame = None if section is None else section.frame
    return ExtrinsicsTask(folder, camera, spec.camera, spec.shots, targets, surveys, frame)


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


def _survey(path: Path, name: str, target: Target, spec: TargetSpec, section: SurveySection | None) -> Survey:
    where = f"{path}: targets.{name}"
    outline = on_board(patterns(target)[0].outline)
    if section is not None and name in section.corners:
        if spec.corners_m is not None or spec.sigma_m is not None:
            raise DocumentError(
                f"{where}: expected neither corners_m nor sigma_m, for survey.targets names its points"
            )
        return Survey(name, outline, section.corners[name], section.sigma)
    if spec.corners_m is None or spec.sigma_m is None:
        key = "corners_m" if spec.corners_m is None else "sigma_m"
        raise DocumentError(f"{where}.{key}: is missing")
    corners = spec.corners_m
    points = np.array([corners.top_left, corners.top_right, corners.bottom_left])
    return Survey(name, outline, points, spec.sigma_m)


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
