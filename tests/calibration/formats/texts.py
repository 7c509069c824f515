"""Texts of camera files as their programs write them, and what a camera images."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.formats.camera_file import FiledCamera
from palletloc.cameras import CameraModel, KannalaBrandt
from palletloc.geometry import FloatArray

Written = Callable[..., CameraModel]
"""Reads the camera of a text."""


def rays_of(camera: CameraModel, step: int = 41) -> FloatArray:
    """Return rays all over an image, (n, 3): right, down, forward."""
    u, v = np.meshgrid(np.arange(9.0, camera.width - 9, step), np.arange(9.0, camera.height - 9, step))
    rays, _, valid = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    assert valid.sum() > 30
    return np.stack([-rays[:, 1], -rays[:, 2], rays[:, 0]], axis=-1)[valid]


def pixels_of(camera: CameraModel, rays: FloatArray) -> FloatArray:
    return camera.project(np.stack([rays[:, 2], -rays[:, 0], -rays[:, 1]], axis=-1)).pixels


MATRIX = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
INFO: dict[str, Any] = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "front",
    "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.2, 0.05, 0.001, -0.002, 0.0]},
}
ECHO = """header:
  seq: 3
  stamp: {{secs: {secs}, nsecs: 5}}
  frame_id: "cam"
height: 480
width: 640
distortion_model: "{kind}"
D: {terms}
K: {matrix}
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: {binning}
binning_y: {binning}
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""


def echo(
    secs: int = 1, kind: str = "plumb_bob", terms: object = (-0.2, 0.05, 0.0, 0.0, 0.0), binning: int = 0
) -> str:
    return ECHO.format(secs=secs, kind=kind, terms=list(terms), matrix=MATRIX, binning=binning)  # type: ignore[call-overload]


METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>{kind}</projection>
  <width>1600</width>
  <height>1200</height>
{numbers}
  <date>2024-01-01T00:00:00Z</date>
</calibration>
"""


def metashape(kind: str, **numbers: float) -> str:
    lines = "\n".join(f"  <{key}>{number!r}</{key}>" for key, number in numbers.items())
    return METASHAPE.format(kind=kind, numbers=lines)


CAMODOCAL = """%YAML:1.0
---
model_type: {kind}
camera_name: camera
image_width: 800
image_height: 600
"""
MEI = """mirror_parameters:
   xi: 1.7
distortion_parameters:
   k1: -0.02
   k2: 0.9
   p1: 0.001
   p2: -0.002
projection_parameters:
   gamma1: 700.
   gamma2: 702.
   u0: 405.
   v0: 296.
"""
SCARAMUZZA = """poly_parameters:
   p0: -220.
   p1: 0.
   p2: 1.5e-03
   p3: -1.2e-06
   p4: 4.0e-09
inv_poly_parameters:
   p0: 330.
   p1: 190.
   p2: -5.
   p3: 10.
affine_parameters:
   ac: 1.01
   ad: 2.0e-03
   ae: -1.0e-03
   cx: 405.
   cy: 296.
"""


def chain(count: int) -> list[FiledCamera]:
    turn = Rotation.from_rotvec([0.02, -0.05, 0.1])
    found = []
    for i in range(count):
        lens = KannalaBrandt(640, 480, 400.0 + i, 401.0, 320.0, 240.0, 0.01, max_angle=1.2)
        place = RigidTransform.from_components([0.1 * i, 0.02 * i * i, 0.0], turn**i)
        found.append(FiledCamera(f"cam{i}", lens, place))
    return found
