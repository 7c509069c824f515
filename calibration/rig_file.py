"""The file rig.yaml: camera and mounting, in the form that recording.yaml has them in."""

from __future__ import annotations

from typing import Literal

import numpy as np

from palletloc.io.camera_spec import angles_from_transform, degrees
from palletloc.io.schema import CameraSpec, MountingSpec
from palletloc.io.yaml_document import Document, format_document
from palletloc.mounting import Mounting


class _RigSpec(Document):
    """The file rig.yaml."""

    format: Literal[1]
    camera: CameraSpec
    forklift_from_camera: MountingSpec


def rig_text(camera: CameraSpec, mounting: Mounting) -> str:
    """Return the content of rig.yaml: the camera, and the mounting with its standard deviations."""
    translation, angles = angles_from_transform(mounting.forklift_from_camera)
    x, y, z = (round(value, 6) for value in translation)
    roll, pitch, yaw = (round(angle, 5) for angle in angles)
    sx, sy, sz = (_two_digits(value) for value in mounting.translation_sigma)
    sroll, spitch, syaw = (_two_digits(degrees(value)) for value in mounting.rotation_sigma)
    spec = _RigSpec(
        format=1,
        camera=camera,
        forklift_from_camera=MountingSpec(
            translation_m=(x, y, z),
            roll_pitch_yaw_deg=(roll, pitch, yaw),
            translation_sigma_m=(sx, sy, sz),
            rotation_sigma_deg=(sroll, spitch, syaw),
        ),
    )
    return format_document(spec)


def _two_digits(sigma: float) -> float:
    """Return a standard deviation with two significant digits, as many as it is known to."""
    return float(f"{sigma:.2g}") if np.isfinite(sigma) else 0.0
