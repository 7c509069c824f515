"""Our own form: the key ``camera`` of recording.yaml, rig.yaml and the files that a calibration of lenses writes."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from calibration.formats.fields import read_yaml
from palletloc.cameras import CameraModel
from palletloc.io.camera_spec import camera_from_spec, spec_from_camera
from palletloc.io.schema import CameraSpec
from palletloc.io.yaml_document import Document, DocumentError, checked_document, format_document


class CameraSheet(Document):
    """The file that a calibration of lenses writes."""

    format: Literal[1]
    camera: CameraSpec


class CameraOnly(Document):
    """The camera in any file of ours."""

    camera: CameraSpec


def read_own(path: Path) -> CameraModel:
    """Return the camera of a file of ours, whatever else the file holds.

    Raises
    ------
    InputError
        If its key ``camera`` does not describe one.
    """
    content = read_yaml(path).value
    spec = checked_document(path, {"camera": content["camera"]}, CameraOnly).camera
    try:
        return camera_from_spec(spec)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from None


def camera_text(camera: CameraModel) -> str:
    """Return a camera in our own form."""
    return format_document(CameraSheet(format=1, camera=spec_from_camera(camera)))
