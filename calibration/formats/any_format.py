"""Which program wrote a camera file: told by its keys, never by its name; and what those that are not read are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from calibration.formats.basalt import read_basalt
from calibration.formats.camera_file import FiledCamera, as_cameras
from calibration.formats.camera_matrix import MATRIX, read_camera_matrix
from calibration.formats.fields import Fields, FormatError
from calibration.formats.kalibr import camera_keys, read_kalibr
from calibration.formats.named_numbers import read_named, reads_named
from calibration.formats.ocam import read_ocam
from calibration.formats.syntax import TABLE, read_documents
from palletloc.io.camera_spec import camera_in
from palletloc.io.reading import read_text, require_file

_Reader = Callable[[Fields], list[FiledCamera]]
"""What reads one program's files."""


def _ours(fields: Fields) -> list[FiledCamera]:
    return as_cameras(camera_in(fields.path, fields.value), "camera")


_READERS: tuple[tuple[Callable[[Fields], bool], _Reader], ...] = (
    (lambda fields: fields.has("value0"), read_basalt),
    (lambda fields: bool(camera_keys(fields)), read_kalibr),
    (reads_named, read_named),
    (lambda fields: fields.has("camera"), _ours),
    (lambda fields: any(_holds(fields, key) for key in MATRIX), read_camera_matrix),
    (lambda fields: fields.has(TABLE), read_ocam),
)
"""Whether a file is one of a program's, and what reads it; in this order."""
_NOT_READ = {
    "taylor_coefficient": "a camera of py-OCamCalib, which does not say the image's size and has other polynomials"
    " than OCamCalib; expected a calib_results.txt of OCamCalib, or another calibration",
    "target_type": "a target of Kalibr, no camera; expected it under boards in intrinsics.yaml, as kalibr: FILE",
    "cam0_calib": "settings of VINS-Fusion; expected the file that cam0_calib names",
    "accelerometer_noise_density": "Kalibr's file of an inertial sensor; expected its camchain, with cam0",
    "frames": "a transforms.json of nerfstudio whose images have cameras of their own, or only an angle of view;"
    " expected fl_x, fl_y, cx, cy, w and h at its top",
    "Calibration.cameras": "a calibration of calib.io; expected it exported as OpenCV's or Kalibr's",
    "lensmodel": "a camera of mrcal; expected it converted by mrcal-to-kalibr",
    "document": "a project of Metashape; expected the camera's own file: Tools, Camera Calibration, Save (XML)",
    "chunk": "a project of Metashape; expected the camera's own file: Tools, Camera Calibration, Save (XML)",
    "xmpmeta": "the XMP of a photo (RealityCapture); expected a calibration by COLMAP, OpenCV or Metashape",
    "LandXML": "a survey, no camera",
    "objectPoints": "a file of corners, no camera; expected it under corners in intrinsics.yaml",
    "forklift_from_camera": "a mounting without a camera; expected the key camera",
    "Stereo.T_c1_c2": "settings of a stereo camera without Camera1; expected Camera1.fx and the others",
    "camera_angle_x": "an angle of view without a lens; expected fl_x, fl_y, cx, cy, w and h",
}
"""Keys of files that are not read: what they are, and what is read in their place."""
_COMMENTS = {
    "# Image list": "COLMAP's images.txt; expected its cameras.txt",
    "# 3D point list": "COLMAP's points3D.txt; expected its cameras.txt",
}
"""The same by the first line of tables."""
_NONE = (
    "is no camera file; expected the keys camera (palletloc), cam0 (Kalibr), value0 (basalt), camera_matrix or K"
    " (ROS, OpenCV), model_type (CamOdoCal), fl_x (nerfstudio), calibration (Metashape), Camera.fx (ORB-SLAM) or"
    " parameter (fisheye-calib-adapter), or a table of COLMAP or OCamCalib"
)
"""What is said of other files."""
_SECOND = ("Camera2.fx", "M2", "cameraMatrix2")
"""Keys of a second camera in files of which the first is read."""
_NOT_THE_CAMERA = ("header", "stamp")
"""Keys of a CameraInfo that differ from one message to the next."""


def read_cameras(path: Path) -> list[FiledCamera]:
    """Return the cameras of a file, whichever program wrote it.

    Parameters
    ----------
    path : Path
        Ours; or of Kalibr, basalt, ROS, OpenCV, OCamCalib, COLMAP, nerfstudio, Metashape, CamOdoCal, ORB-SLAM,
        stella_vslam or fisheye-calib-adapter.

    Raises
    ------
    InputError
        If it is none of them, or does not hold what its form says; names file and key.
    """
    documents = read_documents(require_file(path, "a camera file of any known format"))
    fields = _the_one(documents)
    if fields.has("opencv_storage"):
        fields = Fields(path, "", fields.at("opencv_storage").value or {})
        return _read(fields, read_named if reads_named(fields) else read_camera_matrix)
    for is_one, reader in _READERS:
        if is_one(fields):
            return _read(fields, reader)
    raise FormatError(f"{path}: {_what(fields)}")


def _read(fields: Fields, reader: _Reader) -> list[FiledCamera]:
    start = read_text(fields.path).lstrip()[:40]
    for comment, what in _COMMENTS.items():
        if fields.has(TABLE) and start.startswith(comment):
            raise FormatError(f"{fields.path}: is {what}")
    found = reader(fields)
    second = next((key for key in _SECOND if fields.has(key)), None)
    if second is not None and len(found) == 1:
        note = f"{second} and the rest of the second camera are not read; expected it in a file of its own"
        found = [replace(found[0], note=found[0].note or note)]
    return found


def _holds(fields: Fields, key: str) -> bool:
    return fields.has(key) and fields.at(key).value is not None


def _what(fields: Fields) -> str:
    """Return what a file is that is not read."""
    for key, what in _NOT_READ.items():
        if fields.has(key):
            return f"is {what}"
    value = fields.value
    inner = value.values() if isinstance(value, dict) else ()
    if any(isinstance(entry, dict) and "projection_type" in entry for entry in inner):
        return "is a camera of OpenSfM; expected a calibration by COLMAP, OpenCV or Metashape"
    keys = ", ".join(str(key)[:30] for key in list(value)[:6]) if isinstance(value, dict) else ""
    return _NONE + (f"; it has {keys}" if keys else "")


def _the_one(documents: Sequence[Fields]) -> Fields:
    """Return the camera that all documents of a file describe: messages that were printed one after another.

    The last one may be cut off.
    """
    first = documents[0]
    for number, document in enumerate(documents[1:], start=2):
        cut_off = number == len(documents)
        if not _agree(first.value, document.value, cut_off=cut_off):
            raise FormatError(
                f"{first.path}: document {number} (after ---) is another than the first; expected one camera"
            )
    return first


def _agree(first: Any, other: Any, *, cut_off: bool) -> bool:
    if not isinstance(first, dict) or not isinstance(other, dict):
        return bool(first == other)
    keys = set(other) if cut_off else set(first) | set(other)
    last = list(other)[-1] if cut_off and other else None
    return all(
        first.get(key) == other.get(key)
        for key in keys
        if key not in _NOT_THE_CAMERA and not (key == last and set(other) != set(first))
    )
