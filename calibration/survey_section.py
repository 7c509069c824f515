"""The section `survey` of extrinsics.yaml: targets and forklift as a total station has surveyed them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from calibration.forklift_frame import ForkliftFrame, direct_frame, frame_from_points, frame_from_wheels
from palletloc.geometry import FloatArray
from palletloc.io.schema import Triple
from palletloc.io.yaml_document import Document, DocumentError
from palletloc.survey.plan import Name, PrismSpec, Sigma, prism_use
from palletloc.survey.point import Survey
from palletloc.survey.reading import read_survey

_FLOOR_SIGMA = 0.001


class NamedCornersSpec(Document):
    """Names of the points at a pattern's corners."""

    top_left: Name
    top_right: Name
    bottom_left: Name


class DirectSpec(Document):
    """The survey is in the forklift frame already."""

    method: Literal["direct"]


class MeasuredPointsSpec(Document):
    """Points, such as prisms, whose places in the forklift frame are known."""

    method: Literal["measured_points"]
    points: Annotated[dict[Name, Triple], Field(min_length=1)]
    sigma_m: Sigma | None = None
    """Of these places; exact without it."""


class WheelMarksSpec(Document):
    """The frame is defined by the floor and by two wheels of one axle."""

    method: Literal["wheel_marks"]
    floor: Annotated[tuple[Name, ...], Field(min_length=1)]
    left_wheel: Name
    right_wheel: Name
    ahead: Name | None = None
    """Any point before the axle."""
    floor_sigma_m: Sigma = _FLOOR_SIGMA
    """How flat the floor is."""


FrameSpec = Annotated[DirectSpec | MeasuredPointsSpec | WheelMarksSpec, Field(discriminator="method")]
"""How the forklift frame is known."""


class SurveySectionSpec(Document):
    """The section."""

    file: Annotated[str, Field(min_length=1)]
    sigma_m: Sigma
    prism: PrismSpec | None = None
    targets: Annotated[dict[str, NamedCornersSpec], Field(min_length=1)]
    frame: FrameSpec


@dataclass(frozen=True, slots=True, eq=False)
class SurveySection:
    """What a survey says."""

    frame: ForkliftFrame
    """Where the forklift stood."""
    corners: Mapping[str, FloatArray]
    """(3, 3) upper left, upper right and lower left corner of each target; in the forklift frame if known."""
    sigma: float
    """Standard deviation of each coordinate, in metres."""


def read_survey_section(path: Path, spec: SurveySectionSpec) -> SurveySection:
    """Read the survey that a file names.

    Parameters
    ----------
    path : Path
        The file that has the section; the survey's name is relative to its folder.
    spec : SurveySectionSpec
        The section.

    Raises
    ------
    InputError
        If the survey cannot be read, lacks a point, or contradicts the forklift's own distances.
    """
    names = [name for one in spec.targets.values() for name in (one.top_left, one.top_right, one.bottom_left)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise DocumentError(f"{path}: survey.targets: point '{twice}' stands there twice; expected every point once")
    prism = prism_use(spec.prism) if spec.prism is not None else None
    survey = read_survey(path.parent / spec.file, prism)
    corners = {
        name: np.array([survey.require(p).position for p in (one.top_left, one.top_right, one.bottom_left)])
        for name, one in spec.targets.items()
    }
    frame = _frame(path, survey, spec)
    if frame.pose is not None:
        forklift_from_world = frame.pose.target_from_source.inv()
        corners = {name: forklift_from_world.apply(points) for name, points in corners.items()}
    return SurveySection(frame, corners, spec.sigma_m)


def _frame(path: Path, survey: Survey, spec: SurveySectionSpec) -> ForkliftFrame:
    match spec.frame:
        case MeasuredPointsSpec() as measured:
            sigma = float(np.hypot(spec.sigma_m, measured.sigma_m or 0.0))
            places = {name: np.array(place) for name, place in measured.points.items()}
            return frame_from_points(survey, places, sigma)
        case WheelMarksSpec() as marks:
            wheels = (marks.left_wheel, marks.right_wheel)
            if wheels[0] == wheels[1]:
                raise DocumentError(f"{path}: survey.frame: left_wheel and right_wheel are both '{wheels[0]}'")
            return frame_from_wheels(survey, marks.floor, wheels, spec.sigma_m, marks.floor_sigma_m, marks.ahead)
        case DirectSpec():
            return direct_frame()
