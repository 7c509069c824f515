"""Reading and writing shots, with guards against what is not one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from palletloc.geometry import Image
from palletloc.io.atomic import write_bytes
from palletloc.io.image_header import read_header
from palletloc.io.reading import InputError, read_bytes

MAX_SIDE_PX = 16_384
"""Longest side that is decoded; ``cv2.remap`` itself ends at 32 767."""
MAX_PIXELS = 1 << 27
"""Most pixels that are decoded: 16 384 x 8192, 400 MB in colour."""


class ImageError(InputError):
    """An image that is missing, damaged, too large, or not of the camera's size."""


def read_image(path: Path, size: tuple[int, int] | None = None, *, gray: bool = False) -> Image:
    """Read a JPEG or PNG file; its pixels as the camera wrote them, whatever its EXIF orientation says.

    Size and completeness are read from the file's own structure first: a huge or truncated file is never
    decoded. Damage inside the compressed data of a complete JPEG file cannot be seen that way.

    Parameters
    ----------
    path : Path
        The file.
    size : (width, height), optional
        What the camera says, in pixels.
    gray : bool
        Whether to decode to gray, which is faster.

    Returns
    -------
    (height, width, 3) or (height, width) array of uint8
        In blue-green-red order, or gray.

    Raises
    ------
    ImageError
        If the file is missing, is not such an image, is cut off, or has another or too large a size.
    """
    try:
        content = read_bytes(path)
    except InputError as error:
        raise ImageError(str(error)) from error
    _check_content(path, content, size)
    flag = cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(f"{path}: is damaged, it cannot be decoded")
    return np.asarray(image, dtype=np.uint8)


def _check_content(path: Path, content: bytes, size: tuple[int, int] | None) -> None:
    """Raise an error where the content should not be decoded."""
    if not content:
        raise ImageError(f"{path}: is empty; expected a JPEG or PNG image")
    header = read_header(content)
    if header is None:
        raise ImageError(f"{path}: is not a JPEG or PNG image, or is cut off before its size")
    width, height, complete = header
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and width * height <= MAX_PIXELS):
        raise ImageError(
            f"{path}: is {width} x {height} px; expected at most {MAX_SIDE_PX} px a side and {MAX_PIXELS} px in all"
        )
    if size is not None and (width, height) != size:
        raise ImageError(f"{path}: is {width} x {height} px, the camera is {size[0]} x {size[1]} px")
    if not complete:
        raise ImageError(f"{path}: is truncated or damaged; expected all of the image")


def write_image(path: Path, image: Image, *, quality: int = 95) -> None:
    """Write an image whole or not at all, in the format that its name says.

    Parameters
    ----------
    path : Path
        Ends in ``.jpg``, ``.jpeg`` or ``.png``.
    image : (height, width, 3) or (height, width) array of uint8
        In blue-green-red order, or gray.
    quality : int
        Of a JPEG image, 0 to 100.

    Raises
    ------
    ValueError
        If the name ends otherwise.
    OutputError
        If the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in (".jpg", ".jpeg", ".png"):
        raise ValueError(f"{path}: expected a name that ends in .jpg, .jpeg or .png")
    options = [] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, quality]
    done, content = cv2.imencode(suffix, image, options)
    if not done:
        raise ValueError(f"{path}: the image of shape {image.shape} cannot be encoded")
    write_bytes(path, content.tobytes())
