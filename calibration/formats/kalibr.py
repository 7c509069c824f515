"""Kalibr's camchain: cameras by name, each with its place against the one before."""

from __future__ import annotations

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


def read_kalibr(fields: Fields) -> list[FiledCamera]:
    """Return the cameras of a camchain, in its order; argument and errors as for `read_basalt`."""
    names = sorted(key for key in fields.value if str(key).startswith("cam"))
    found, place = list[FiledCamera](), RigidTransform.identity()
    for i, name in enumerate(names):
        entry = fields.at(name)
        if i:
            rows = [row.numbers(4) for row in entry.at("T_cn_cnm1").items()]
            if len(rows) != 4:
                raise entry.at("T_cn_cnm1").fault("4 rows of 4 numbers")
            place = place * from_optical(entry.at("T_cn_cnm1"), np.array(rows)).inv()
        found.append(FiledCamera(name, _camera(entry), place))
    return found


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
