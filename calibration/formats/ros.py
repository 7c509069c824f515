"""The camera_info of ROS: one pinhole or fisheye camera."""

from __future__ import annotations

import yaml

from calibration.formats.camera_file import FiledCamera, alone, filed_lens, filed_shape
from calibration.formats.fields import Fields
from palletloc.cameras import CameraModel

MODELS = ("kannala_brandt", "pinhole")
"""What the format can hold."""
_DISTORTIONS = ("plumb_bob", "equidistant", "fisheye", "rational_polynomial")
"""Names of the distortions."""


def read_camera_info(fields: Fields) -> list[FiledCamera]:
    """Return the camera of a camera_info; argument and errors as for `read_basalt`."""
    size = fields.at("image_width").side(), fields.at("image_height").side()
    matrix = fields.at("camera_matrix").at("data").numbers(9)
    lens = matrix[0], matrix[4], matrix[2], matrix[5]
    name = fields.at("camera_name").text() if fields.has("camera_name") else "camera"
    kind = fields.at("distortion_model").text(_DISTORTIONS)
    data = fields.at("distortion_coefficients").at("data")
    fisheye = kind in ("equidistant", "fisheye")
    terms = data.numbers(4) if fisheye else data.numbers(4, 5, 8)
    if any(terms[5:]):
        raise data.fault("no terms beyond k3: a rational distortion has no form here")
    return [alone(name, filed_lens(fields, "kannala_brandt" if fisheye else "pinhole", size, lens, terms[:5]))]


def camera_info_text(camera: CameraModel, name: str) -> str:
    """Return a camera_info; errors as for `basalt_text`."""
    model, (fx, fy, cx, cy), terms = filed_shape(camera, MODELS, "camera_info")
    kind = "equidistant" if model == "kannala_brandt" else "plumb_bob"
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _matrix(3, [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_model": kind,
        "distortion_coefficients": _matrix(1, terms),
        "rectification_matrix": _matrix(3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": _matrix(3, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)


def _matrix(rows: int, data: list[float]) -> dict[str, object]:
    return {"rows": rows, "cols": len(data) // rows, "data": data}
