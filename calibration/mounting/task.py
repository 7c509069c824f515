"""The file extrinsics.yaml: a camera, shots from a forklift that stands still, and surveyed targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from calibration.mounting.forklift_frame import ForkliftFrame, direct_frame, frame_from_points, frame_from_wheels
from calibration.mounting.problem import SurveyedTarget
from calibration.targets.target_file import CharucoSpec, Positive, TagSpec, refuse_shared_ids, target_from_spec
from calibration.targets.targets import Target, on_board, patterns
from palletloc.cameras.protocol import CameraModel
from palletloc.errors import nearest_name
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import camera_from_spec
from palletloc.io.reading import InputError, require_file
from palletloc.io.schema import CameraSpec, Triple
from palletloc.io.yaml_document import Document, DocumentError, read_document
from palletloc.survey.plan import Columns, Name, PrismSpec, Sigma, prism_use
from palletloc.survey.point import Survey
from palletloc.survey.reading import read_survey

EXTRINSICS = "extrinsics.yaml"
"""Name of the file in its folder."""
_FLOOR_SIGMA = 0.001
"""How flat a floor is where nothing is said: standard deviation of its height, in metres."""


class CornersSpec(Document):
    """Surveyed corners of the printed pattern, seen from its front, in `forklift`."""

    top_left: Triple
    top_right: Triple
    bottom_left: Triple

    def points(self) -> FloatArray:
        """Return them in the order of a pattern's outline, (3, 3)."""
        return np.array([self.top_left, self.top_right, self.bottom_left])


class _TargetSpec(Document):
    """One target: `charuco` or `tag`, and where it is."""

    charuco: CharucoSpec | None = None
    tag: TagSpec | None = None
    corners_m: CornersSpec | None = None
    """Not for a target that the section `survey` names."""
    sigma_m: Positive | None = None
    """Standard deviation of each surveyed coordinate."""


class _NamedCornersSpec(Document):
    """Names of the points at a pattern's corners."""

    top_left: Name
    top_right: Name
    bottom_left: Name

    def names(self) -> tuple[str, str, str]:
        """Return them in the order of a pattern's outline."""
        return self.top_left, self.top_right, self.bottom_left


class _DirectSpec(Document):
    """The survey is in the forklift frame already."""

    method: Literal["direct"]


class _MeasuredPointsSpec(Document):
    """Points, such as prisms, whose places in the forklift frame are known."""

    method: Literal["measured_points"]
    points: Annotated[dict[Name, Triple], Field(min_length=1)]
    sigma_m: Sigma | None = None
    """Of these places; exact without it."""


class _WheelMarksSpec(Document):
    """The frame is defined by the floor and by two wheels of one axle."""

    method: Literal["wheel_marks"]
    floor: Annotated[tuple[Name, ...], Field(min_length=1)]
    left_wheel: Name
    right_wheel: Name
    ahead: Name | None = None
    """Any point before the axle."""
    floor_sigma_m: Sigma = _FLOOR_SIGMA
    """How flat the floor is."""


_FrameSpec = Annotated[_DirectSpec | _MeasuredPointsSpec | _WheelMarksSpec, Field(discriminator="method")]
"""How the forklift frame is known."""


class _SurveySectionSpec(Document):
    """The section `survey`: targets and forklift as a total station has surveyed them."""

    file: Annotated[str, Field(min_length=1)]
    sigma_m: Sigma
    prism: PrismSpec | None = None
    columns: Columns | None = None
    targets: Annotated[dict[str, _NamedCornersSpec], Field(min_length=1)]
    frame: _FrameSpec


class _ExtrinsicsSpec(Document):
    """The file extrinsics.yaml."""

    format: Literal[1]
    camera: CameraSpec
    shots: Annotated[tuple[str, ...], Field(min_length=1)]
    """Images, relative to the folder."""
    targets: Annotated[dict[str, _TargetSpec], Field(min_length=1)]
    survey: _SurveySectionSpec | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MountingTask:
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
    surveys: dict[str, SurveyedTarget]
    """By name; in the forklift frame."""
    frame: ForkliftFrame | None = None
    """Where the forklift stood in the survey; None where the corners were given in its frame."""


def read_mounting_task(folder: Path, columns: Sequence[str] | None = None) -> MountingTask:
    """Read and check the file extrinsics.yaml of a folder; the shots stay in their files.

    Raises
    ------
    PalletLocError
        If the file or its survey is missing or wrong; names file, key and what was expected.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one with {EXTRINSICS} in it")
    path = require_file(folder / EXTRINSICS, "the camera, its shots and the surveyed targets")
    spec = read_document(path, _ExtrinsicsSpec)
    try:
        camera = camera_from_spec(spec.camera)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from error
    targets = {name: target_from_spec(path, name, given.charuco, given.tag) for name, given in spec.targets.items()}
    refuse_shared_ids(path, targets)
    section = None if spec.survey is None else _read_survey_section(path, spec.survey, columns)
    unknown = next((name for name in (section.corners if section else ()) if name not in targets), None)
    if unknown is not None:
        raise DocumentError(f"{path}: survey.targets: unknown target '{unknown}'{nearest_name(unknown, targets)}")
    surveys = {name: _survey(path, name, targets[name], given, section) for name, given in spec.targets.items()}
    frame = None if section is None else section.frame
    return MountingTask(folder, camera, spec.camera, spec.shots, targets, surveys, frame)


@dataclass(frozen=True, slots=True, eq=False)
class _SurveySection:
    """What a survey says."""

    frame: ForkliftFrame
    """Where the forklift stood."""
    corners: Mapping[str, FloatArray]
    """(3, 3) upper left, upper right and lower left corner of each target; in the forklift frame if known."""
    sigma: float
    """Standard deviation of each coordinate, in metres."""


def _read_survey_section(path: Path, spec: _SurveySectionSpec, columns: Sequence[str] | None) -> _SurveySection:
    """Read the survey that the section of a file names; its name is relative to the file's folder."""
    names = [name for corner in spec.targets.values() for name in corner.names()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DocumentError(f"{path}: survey.targets: point '{twice}' stands there twice; expected every point once")
    prism = prism_use(spec.prism) if spec.prism is not None else None
    survey = read_survey(path.parent / spec.file, prism, columns=columns or spec.columns)
    corners = {
        name: np.array([survey.require(point).position for point in corner.names()])
        for name, corner in spec.targets.items()
    }
    frame = _frame(path, survey, spec)
    if frame.pose is not None:
        forklift_from_world = frame.pose.target_from_source.inv()
        corners = {name: forklift_from_world.apply(points) for name, points in corners.items()}
    return _SurveySection(frame, corners, spec.sigma_m)


def _frame(path: Path, survey: Survey, spec: _SurveySectionSpec) -> ForkliftFrame:
    match spec.frame:
        case _MeasuredPointsSpec() as measured:
            sigma = float(np.hypot(spec.sigma_m, measured.sigma_m or 0.0))
            places = {name: np.array(place) for name, place in measured.points.items()}
            return frame_from_points(survey, places, sigma)
        case _WheelMarksSpec() as marks:
            wheels = (marks.left_wheel, marks.right_wheel)
            if wheels[0] == wheels[1]:
                raise DocumentError(f"{path}: survey.frame: left_wheel and right_wheel are both '{wheels[0]}'")
            return frame_from_wheels(survey, marks.floor, wheels, spec.sigma_m, marks.floor_sigma_m, marks.ahead)
        case _DirectSpec():
            return direct_frame()


def _survey(
    path: Path, name: str, target: Target, spec: _TargetSpec, section: _SurveySection | None
) -> SurveyedTarget:
    where = f"{path}: targets.{name}"
    outline = on_board(patterns(target)[0].outline)
    if section is not None and name in section.corners:
        if spec.corners_m is not None or spec.sigma_m is not None:
            raise DocumentError(
                f"{where}: expected neither corners_m nor sigma_m, for survey.targets names its points"
            )
        return SurveyedTarget(name, outline, section.corners[name], section.sigma)
    if spec.corners_m is None or spec.sigma_m is None:
        key = "corners_m" if spec.corners_m is None else "sigma_m"
        raise DocumentError(f"{where}.{key}: is missing")
    return SurveyedTarget(name, outline, spec.corners_m.points(), spec.sigma_m)
