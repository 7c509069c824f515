"""The calibration.json of basalt: cameras and their places on the device."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.formats.camera_file import FiledCamera, filed_lens, filed_shape, from_optical, optical
from calibration.formats.fields import Fields
from palletloc.cameras import CameraModel

MODELS = ("kannala_brandt", "double_sphere", "eucm", "pinhole", "rational_pinhole")
"""What the format can hold."""
_MODELS = {"ds": "double_sphere", "eucm": "eucm", "kb4": "kannala_brandt", "pinhole": "pinhole"}
"""The format's names of models that have one form."""
_KINDS = {
    "ds": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
    "kb4": ("k1", "k2", "k3", "k4"),
    "pinhole": (),
    "ucm": ("alpha",),
    "pinhole-radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
"""All names of the format's models, with the keys of their shapes."""
_LENS = ("fx", "fy", "cx", "cy")
"""Keys that all models have."""
_PLACE, _TURN = ("px", "py", "pz"), ("qx", "qy", "qz", "qw")
"""Keys of a pose: position, and quaternion with the scalar last."""


def read_basalt(fields: Fields) -> list[FiledCamera]:
    """Return the cameras of a calibration, in its order.

    Parameters
    ----------
    fields : Fields
        The whole file.

    Raises
    ------
    FormatError
        If it does not hold what the format says.
    """
    whole = fields.at("value0")
    lenses, sizes = whole.at("intrinsics").items(), whole.at("resolution").items()
    places = whole.at("T_imu_cam").items()
    if not lenses or not len(lenses) == len(sizes) == len(places):
        raise whole.at("resolution").fault(f"as many entries as intrinsics and T_imu_cam have, {len(lenses)}")
    on_device = [_place(place) for place in places]
    return [
        FiledCamera(f"cam{i}", _camera(lens, size.size()), on_device[0].inv() * on_device[i])
        for i, (lens, size) in enumerate(zip(lenses, sizes, strict=True))
    ]


def _place(fields: Fields) -> RigidTransform:
    x, y, z = (fields.at(key).number() for key in _PLACE)
    turn = np.array([fields.at(key).number() for key in _TURN])
    if not abs(np.linalg.norm(turn) - 1) < 1e-3:
        raise fields.fault("a quaternion of length 1")
    matrix = RigidTransform.from_components([x, y, z], Rotation.from_quat(turn)).as_matrix()
    return from_optical(fields, np.asarray(matrix))


def _camera(fields: Fields, size: tuple[int, int]) -> CameraModel:
    kind = fields.at("camera_type").text(tuple(_KINDS))
    values = fields.at("intrinsics")
    lens, shape = ([values.at(key).number() for key in keys] for keys in (_LENS, _KINDS[kind]))
    if any(shape[5:]):
        return filed_lens(values, "rational_pinhole", size, lens, shape)
    if kind == "ucm":
        return filed_lens(values, "eucm", size, lens, [*shape, 1.0])
    return filed_lens(values, _MODELS.get(kind, "pinhole"), size, lens, shape[:5])


def basalt_text(cameras: Sequence[FiledCamera]) -> str:
    """Return a calibration; what it says of an inertial sensor is neutral, and the first camera is the device.

    Raises
    ------
    ValueError
        If the format does not know a camera's model.
    """
    content = {
        "T_imu_cam": [_pose(filed.first_from_camera) for filed in cameras],
        "intrinsics": [_entry(filed.camera) for filed in cameras],
        "resolution": [[filed.camera.width, filed.camera.height] for filed in cameras],
        "calib_accel_bias": [0.0] * 9,
        "calib_gyro_bias": [0.0] * 12,
        "imu_update_rate": 200.0,
        "accel_noise_std": [0.016] * 3,
        "gyro_noise_std": [0.000282] * 3,
        "accel_bias_std": [0.001] * 3,
        "gyro_bias_std": [0.0001] * 3,
        "cam_time_offset_ns": 0,
        "vignette": [],
    }
    return json.dumps({"value0": content}, indent=4) + "\n"


def _pose(first_from_camera: RigidTransform) -> dict[str, float]:
    matrix = optical(first_from_camera)
    turn = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return dict(zip(_PLACE + _TURN, [*matrix[:3, 3].tolist(), *turn.tolist()], strict=True))


def _entry(camera: CameraModel) -> dict[str, object]:
    model, lens, shape = filed_shape(camera, MODELS, "basalt")
    kind = next((kind for kind, name in _MODELS.items() if name == model), "pinhole-radtan8")
    if model == "pinhole":
        kind, shape = ("pinhole-radtan8", [*shape, 0.0, 0.0, 0.0]) if any(shape) else ("pinhole", [])
    return {"camera_type": kind, "intrinsics": dict(zip(_LENS + _KINDS[kind], [*lens, *shape], strict=True))}
