"""OpenCV's calibrations in its FileStorage: pinhole, fisheye and omnidirectional cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.formats.camera_file import FiledCamera, alone, filed_lens, filed_shape
from calibration.formats.fields import Fields, FormatError, StorageFile
from palletloc.cameras import CameraModel
from palletloc.geometry import FloatArray
from palletloc.io.images import MAX_SIDE_PX

MODELS = ("kannala_brandt", "mei", "pinhole")
"""What the format can hold."""
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1")
"""Names that OpenCV's programs give the camera matrix."""
_TERMS = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "Distortion_Coefficients", "D", "D1")
"""Names that OpenCV's programs give the distortion."""
_WIDTH, _HEIGHT, _SIZE = ("image_width", "image_Width"), ("image_height", "image_Height"), ("imageSize", "image_size")
"""Names that OpenCV's programs give the image's size."""


def read_opencv(path: Path) -> list[FiledCamera]:
    """Return the camera of a calibration.

    Parameters
    ----------
    path : Path
        XML, YAML or JSON as FileStorage writes it. A fisheye has ``fisheye_model: 1`` there, an omnidirectional
        camera ``xi``.

    Raises
    ------
    InputError
        If it does not hold a calibration; names the key.
    """
    storage = StorageFile(path)
    size = _size(path, storage)
    matrix = _needed(path, storage, _MATRIX, (9,))
    lens = [float(matrix[i]) for i in (0, 4, 2, 5)]
    terms = _needed(path, storage, _TERMS, (4, 5, 8, 12, 14)).tolist()
    fields = Fields(path, "", None)
    xi, flag = storage.numbers("xi"), storage.numbers("fisheye_model")
    if xi is not None:
        return [alone("camera", filed_lens(fields, "mei", size, lens, [float(xi[0]), *terms[:4]]))]
    fisheye = flag is not None and bool(flag[0])
    if fisheye and len(terms) != 4:
        raise FormatError(f"{path}: distortion_coefficients: expected 4 numbers for a fisheye, got {len(terms)}")
    if any(terms[5:]):
        raise FormatError(f"{path}: distortion_coefficients: expected no terms beyond k3, which have no form here")
    return [alone("camera", filed_lens(fields, "kannala_brandt" if fisheye else "pinhole", size, lens, terms[:5]))]


def _needed(path: Path, storage: StorageFile, names: Sequence[str], counts: Sequence[int]) -> FloatArray:
    for name in names:
        values = storage.numbers(name)
        if values is None:
            continue
        if len(values) not in counts:
            expected = " or ".join(str(count) for count in counts)
            raise FormatError(f"{path}: {name}: expected {expected} numbers, got {len(values)}")
        return values
    raise FormatError(f"{path}: {names[0]}: is missing")


def _size(path: Path, storage: StorageFile) -> tuple[int, int]:
    for name in _SIZE:
        both = storage.numbers(name)
        if both is not None and len(both) == 2:
            return _side(path, name, float(both[0])), _side(path, name, float(both[1]))
    width, height = _needed(path, storage, _WIDTH, (1,)), _needed(path, storage, _HEIGHT, (1,))
    return _side(path, _WIDTH[0], float(width[0])), _side(path, _HEIGHT[0], float(height[0]))


def _side(path: Path, name: str, value: float) -> int:
    if value != int(value) or not 0 < value <= MAX_SIDE_PX:
        raise FormatError(f"{path}: {name}: expected whole pixels, up to {MAX_SIDE_PX}, got {value:g}")
    return int(value)


def opencv_text(camera: CameraModel, suffix: str) -> str:
    """Return a calibration.

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
    model, (fx, fy, cx, cy), shape = filed_shape(camera, MODELS, "OpenCV")
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
