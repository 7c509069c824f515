"""Cameras by a matrix and a list of distortions: ROS's CameraInfo, as a file or printed, and OpenCV's storage.

The keys, the kinds of distortion and what binning and a region of interest do to the image are those of
sensor_msgs/CameraInfo and REP 104; the order of the distortions is that of OpenCV's module calib3d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import yaml

from calibration.formats.camera_file import FiledCamera, alone, filed_lens, filed_shape
from calibration.formats.fields import Fields
from calibration.formats.general_lens import GeneralLens, filed_general
from palletloc.cameras import CameraModel

ROS_MODELS = ("kannala_brandt", "pinhole", "rational_pinhole")
"""What CameraInfo can hold."""
OPENCV_MODELS = ("kannala_brandt", "mei", "pinhole", "rational_pinhole")
"""What OpenCV's storage can hold."""
MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k", "M1")
"""Names of the camera matrix: of ROS's files and OpenCV's programs, and of ROS's messages."""
_TERMS = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients", "D", "d", "D1")
"""Names of the distortion."""
_WIDTH, _HEIGHT = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
"""Names of the sides of the image."""
_SIZE = ("imageSize", "image_size")
"""Names of both sides in one."""
_KINDS = {
    "plumb_bob": "brown",
    "rational_polynomial": "brown",
    "": "brown",
    "none": "brown",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
}
"""ROS's names of distortions."""
_BROWN, _FISHEYE = (0, 4, 5, 8, 12, 14), 4
"""How many numbers OpenCV's distortion may have, and how many that of its fisheye has."""


class _Window(NamedTuple):
    """The part of the sensor that an image shows, and how many of its pixels make one of the image."""

    left: float
    top: float
    width: int
    height: int
    across: int
    down: int

    def lens(self, lens: Sequence[float]) -> tuple[float, ...]:
        """Return fx, fy, cx, cy in the image from those on the sensor; in both, the middle of a pixel is whole."""
        fx, fy, cx, cy = lens
        return (
            fx / self.across,
            fy / self.down,
            (cx - self.left + 0.5) / self.across - 0.5,
            (cy - self.top + 0.5) / self.down - 0.5,
        )


def read_camera_matrix(fields: Fields) -> list[FiledCamera]:
    """Return the camera of a CameraInfo or of OpenCV's storage; argument and errors as for `read_basalt`."""
    sensor = _size(fields)
    matrix_at = _numbers_at(fields, MATRIX)
    matrix = _vector(matrix_at)
    if len(matrix) != 9:
        raise matrix_at.wrong(f"expected 9 numbers, got {len(matrix)}")
    fx, skew, cx, below, fy, cy, *last = matrix
    if not fx and not fy:
        raise matrix_at.wrong("is zero: this camera is not calibrated")
    if below or last != [0.0, 0.0, 1.0]:
        raise matrix_at.wrong("expected fx, 0, cx, 0, fy, cy, 0, 0, 1")
    window = _window(fields, sensor)
    size = max(1, window.width // window.across), max(1, window.height // window.down)
    lens = window.lens((fx, fy, cx, cy))
    if skew:
        skew /= window.across
    return [_lens(fields, size, lens, skew)]


def _lens(fields: Fields, size: tuple[int, int], lens: tuple[float, ...], skew: float) -> FiledCamera:
    terms_at = _numbers_at(fields, _TERMS)
    terms, name = _vector(terms_at), _name(fields)
    if fields.has("xi"):
        xi = _vector(_numbers_at(fields, ("xi",)))
        if len(xi) != 1 or len(terms) < 4 or any(terms[4:]) or skew:
            raise terms_at.wrong("expected one xi, 4 numbers and a matrix without skew for an omnidirectional camera")
        return alone(name, filed_lens(fields, "mei", size, lens, [*xi, *terms[:4]]))
    general = GeneralLens("perspective", *size, tuple(lens), skew=skew)
    if _is_fisheye(fields):
        if len(terms) < _FISHEYE or any(terms[_FISHEYE:]):
            raise terms_at.wrong(f"expected {_FISHEYE} numbers for a fisheye, got {len(terms)}")
        return filed_general(fields, name, replace(general, projection="equidistant", radial=tuple(terms[:_FISHEYE])))
    if len(terms) not in _BROWN:
        counts = " or ".join(str(count) for count in _BROWN[1:])
        raise terms_at.wrong(f"expected {counts} numbers, got {len(terms)}")
    k1, k2, p1, p2, k3, k4, k5, k6, *rest = [*terms, *(0.0,) * (14 - len(terms))]
    filed = filed_general(
        fields,
        name,
        replace(
            general,
            radial=(k1, k2, k3),
            divisor=(k4, k5, k6),
            tangential=(p1, p2),
            prism=tuple(rest[:4]),
            tilt=tuple(rest[4:]),
        ),
    )
    if len(terms) == _FISHEYE and not fields.has("distortion_model") and not fields.has("fisheye_model"):
        note = "four distortions without a model are read as k1, k2, p1, p2; a fisheye has fisheye_model: 1"
        filed = replace(filed, note=filed.note or note)
    return filed


def _is_fisheye(fields: Fields) -> bool:
    if fields.has("distortion_model"):
        stated = fields.at("distortion_model")
        return _KINDS[Fields(stated.path, stated.place, stated.value or "").text(tuple(_KINDS))] == "fisheye"
    return fields.has("fisheye_model") and bool(fields.at("fisheye_model").number())


def _name(fields: Fields) -> str:
    given = fields.at("camera_name").value if fields.has("camera_name") else None
    return given if isinstance(given, str) and given else "camera"


def _numbers_at(fields: Fields, keys: Sequence[str]) -> Fields:
    """Return what stands under the first of several keys that is there; of a matrix its data."""
    found = fields.first(keys)
    return found.at("data") if isinstance(found.value, dict) else found


def _vector(fields: Fields) -> list[float]:
    """Return the numbers of a list, a list of lists, or a single number."""
    if not isinstance(fields.value, list):
        return [] if fields.value in ("", None) else [fields.number()]
    return [
        number
        for item in fields.items()
        for number in (item.numbers(len(item.value)) if isinstance(item.value, list) else (item.number(),))
    ]


def _size(fields: Fields) -> tuple[int, int]:
    for name in _SIZE:
        if fields.has(name) and isinstance(fields.at(name).value, list):
            return fields.at(name).size()
    return fields.first(_WIDTH).side(), fields.first(_HEIGHT).side()


def _window(fields: Fields, sensor: tuple[int, int]) -> _Window:
    """Return what of the sensor the image shows; zeros stand for all of it and for no binning."""
    across, down = (
        fields.at(key).whole(0, max(sensor)) or 1 if fields.has(key) else 1 for key in ("binning_x", "binning_y")
    )
    if not fields.has("roi") or fields.at("roi").value is None:
        return _Window(0, 0, *sensor, across, down)
    roi = fields.at("roi")
    keys = ("x_offset", "y_offset", "width", "height")
    left, top, width, height = (roi.at(key).whole(0, max(sensor)) if roi.has(key) else 0 for key in keys)
    if not (width or height or left or top):
        return _Window(0, 0, *sensor, across, down)
    if not (width and height and left + width <= sensor[0] and top + height <= sensor[1]):
        raise roi.fault(f"a part of the {sensor[0]} x {sensor[1]} px of the sensor")
    return _Window(left, top, width, height, across, down)


def camera_info_text(camera: CameraModel, name: str) -> str:
    """Return a camera_info; errors as for `basalt_text`."""
    model, (fx, fy, cx, cy), terms = filed_shape(camera, ROS_MODELS, "camera_info")
    kinds = {"kannala_brandt": "equidistant", "pinhole": "plumb_bob", "rational_pinhole": "rational_polynomial"}
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_model": kinds[model],
        "distortion_coefficients": _matrix(1, terms),
        "rectification_matrix": _matrix(3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": _matrix(3, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)


def _matrix(rows: int, data: list[float]) -> dict[str, object]:
    return {"rows": rows, "cols": len(data) // rows, "data": data}


def opencv_text(camera: CameraModel, suffix: str) -> str:
    """Return a calibration in OpenCV's storage.

    Parameters
    ----------
    camera : CameraModel
        A pinhole, a Kannala-Brandt fisheye or a camera of Mei.
    suffix : str
        ``.xml``, ``.yml``, ``.yaml`` or ``.json``: the form.

    Raises
    ------
    ValueError
        If the format does not know the camera's model.
    """
    model, (fx, fy, cx, cy), shape = filed_shape(camera, OPENCV_MODELS, "OpenCV")
    terms = shape[1:] if model == "mei" else shape
    storage = cv2.FileStorage(f"camera{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)
    storage.write("camera_matrix", matrix)
    storage.write("distortion_coefficients", np.array([terms], dtype=np.float64))
    if model == "mei":
        storage.write("xi", shape[0])
    else:
        storage.write("fisheye_model", int(model == "kannala_brandt"))
    return str(storage.releaseAndGetString())
