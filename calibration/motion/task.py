"""The file targets.yaml of a recording: targets that hang beside the way; where they hang need not be known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from calibration.drive import DriveNoise
from calibration.motion.problem import SCALE_PRIOR, Height
from calibration.targets.target_file import CharucoSpec, Positive, TagSpec, refuse_shared_ids, target_from_spec
from calibration.targets.targets import Target
from palletloc.io.reading import require_file
from palletloc.io.recording import Recording, read_recording
from palletloc.io.schema import Number
from palletloc.io.yaml_document import Document, DocumentError, read_document

_TARGETS = "targets.yaml"
"""Name of the file in the recording's folder."""
_HEIGHT_SIGMA = 0.003
"""Standard deviation of a height where nothing is said, in metres: a tape measure on a warehouse floor."""


class _MotionTargetSpec(Document):
    """One target: `charuco` or `tag`, and how high it hangs."""

    charuco: CharucoSpec | None = None
    tag: TagSpec | None = None
    height_m: Number | None = None
    """Of the upper left corner of its pattern above the floor."""
    height_sigma_m: Positive | None = None


class _OdometrySpec(Document):
    """Random errors of the odometry after one second, which grow with the root of the time, and of its wheels."""

    position_m: Positive | None = None
    heading_deg: Positive | None = None
    wheel_scale: Positive | None = None
    """Relative, of all distances, as the vehicle's data sheet or a measured way says."""


class _MotionTargetsSpec(Document):
    """The file."""

    format: Literal[1]
    targets: Annotated[dict[str, _MotionTargetSpec], Field(min_length=1)]
    odometry_sigma: _OdometrySpec | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MotionTask:
    """A recording with the targets that it passes."""

    recording: Recording
    """The drive."""

    targets: dict[str, Target]
    """By name."""
    heights: dict[str, Height]
    """Of those whose height is known."""
    noise: DriveNoise
    """How far the odometry may be off."""
    scale_sigma: float
    """How far its distances may be off, one standard deviation; relative."""


def read_motion_task(folder: Path) -> MotionTask:
    """Read a recording and its file targets.yaml.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong; names file, key and what was expected.
    """
    recording = read_recording(folder)
    path = require_file(folder / _TARGETS, "the boards and tags that the recording drives past")
    spec = read_document(path, _MotionTargetsSpec)
    targets = {name: target_from_spec(path, name, given.charuco, given.tag) for name, given in spec.targets.items()}
    refuse_shared_ids(path, targets)
    for name, hung in spec.targets.items():
        if hung.height_sigma_m is not None and hung.height_m is None:
            raise DocumentError(f"{path}: targets.{name}: height_sigma_m goes with height_m")
    heights = {
        name: Height(hung.height_m, hung.height_sigma_m or _HEIGHT_SIGMA)
        for name, hung in spec.targets.items()
        if hung.height_m is not None
    }
    given, usual = spec.odometry_sigma or _OdometrySpec(), DriveNoise()
    heading = usual.heading if given.heading_deg is None else float(np.radians(given.heading_deg))
    noise = DriveNoise(position=given.position_m or usual.position, heading=heading)
    return MotionTask(recording, targets, heights, noise, given.wheel_scale or SCALE_PRIOR)
