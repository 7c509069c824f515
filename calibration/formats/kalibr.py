"""Kalibr's camchain: cameras by name, each with its place against the one before."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import yaml
from scipy.spatial.transform import RigidTransform

from calibration.formats.camera_file import FiledCamera, filed_lens, filed_shape, from_optical, optical
from calibration.formats.fields import Fields
from palletloc.cameras import CameraModel, Pinhole

MODELS = ("kannala_brandt", "mei", "double_sphere", "eucm", "pinhole")
"""What the format can hold."""
_CAMERAS = ("pinhole", "omni", "eucm", "ds")
"""Names of the format's models."""
_DISTORTIONS = {
    "pinhole": ("radtan", "equidistant", "none"),
    "omni": ("radtan", "none"),
    "eucm": ("none",),
    "ds": ("none",),
}
"""Names of each model's distortions."""
_INTRINSICS = {"pinhole": 4, "omni": 5, "eucm": 6, "ds": 6}
"""How many numbers each model has besides its distortion."""
_NAMES = {
    "kannala_brandt": ("pinhole", "equidistant"),
    "mei": ("omni", "radtan"),
    "double_sphere": ("ds", "none"),
    "eucm": ("eucm", "none"),
    "pinhole": ("pinhole", "radtan"),
}
"""The format's names of each model of ours and of its distortion."""
_KEY = re.compile(r"cam\d{1,4}")
"""A camera of a chain."""


def camera_keys(fields: Fields) -> list[str]:
    """Return the keys of a camchain, cam0, cam1, ..., by their numbers."""
    keys = [key for key in (fields.value if isinstance(fields.value, dict) else ()) if isinstance(key, str)]
    return sorted((key for key in keys if _KEY.fullmatch(key)), key=lambda key: int(key[3:]))


def read_kalibr(fields: Fields) -> list[FiledCamera]:
    """Return the cameras of a camchain, in the order of their numbers; argument and errors as for `read_basalt`."""
    names = camera_keys(fields)
    if len(names) == 1:
        return [FiledCamera(names[0], _camera(fields.at(names[0])), RigidTransform.identity())]
    found, place = list[FiledCamera](), RigidTransform.identity()
    for i, name in enumerate(names):
        entry = fields.at(name)
        if name != f"cam{i}":
            # Each place is told against the camera before.
            raise fields.wrong(
                f"cam{i}: is missing, on which the place of {name} rests; expected cameras without gaps"
            )
        if i:
            place = place * _step(fields, names[i - 1], name)
        found.append(FiledCamera(name, _camera(entry), place))
    return found


def _step(fields: Fields, before: str, name: str) -> RigidTransform:
    """Return the place of a camera in the frame of the one before, from either's or from an inertial sensor's."""
    entry = fields.at(name)
    if not entry.has("T_cn_cnm1"):
        for key, inverted in (("T_cam_imu", False), ("T_imu_cam", True)):
            if entry.has(key) and fields.at(before).has(key):
                first, second = (_transform(fields.at(camera).at(key)) for camera in (before, name))
                return first.inv() * second if inverted else first * second.inv()
    return _transform(entry.at("T_cn_cnm1")).inv()


def _transform(given: Fields) -> RigidTransform:
    rows = [row.numbers(4) for row in given.items()]
    if len(rows) != 4:
        raise given.fault("4 rows of 4 numbers")
    return from_optical(given, np.array(rows))


def _camera(entry: Fields) -> CameraModel:
    kind = entry.at("camera_model").text(_CAMERAS)
    bent = entry.at("distortion_model").text(_DISTORTIONS[kind])
    size = entry.at("resolution").size()
    *shape, fx, fy, cx, cy = entry.at("intrinsics").numbers(_INTRINSICS[kind])
    terms = entry.at("distortion_coeffs").numbers(4) if bent != "none" else (0.0,) * 4
    named = (kind, "radtan" if bent == "none" and kind in ("pinhole", "omni") else bent)
    model = next(model for model, names in _NAMES.items() if names == named)
    return filed_lens(entry, model, size, (fx, fy, cx, cy), [*shape, *(() if kind in ("eucm", "ds") else terms)])


def kalibr_text(cameras: Sequence[FiledCamera]) -> str:
    """Return a camchain; errors as for `basalt_text`."""
    content = {}
    for i, filed in enumerate(cameras):
        entry = _entry(filed.camera)
        if i:
            between = filed.first_from_camera.inv() * cameras[i - 1].first_from_camera
            entry = {"T_cn_cnm1": optical(between).tolist(), **entry}
        content[f"cam{i}"] = entry
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)


def _entry(camera: CameraModel) -> dict[str, object]:
    if isinstance(camera, Pinhole) and camera.k3:
        raise ValueError("Kalibr has no form for this Pinhole")
    model, lens, shape = filed_shape(camera, MODELS, "Kalibr")
    kind, bent = _NAMES[model]
    before = _INTRINSICS[kind] - 4
    return {
        "camera_model": kind,
        "intrinsics": [*shape[:before], *lens],
        "distortion_model": bent,
        "distortion_coeffs": shape[before : before + 4],
        "resolution": [camera.width, camera.height],
    }
