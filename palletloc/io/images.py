"""Reading and writing shots, with guards against what is not one."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from palletloc.geometry import Image
from palletloc.io.atomic import write_bytes
from palletloc.io.reading import InputError, read_bytes

MAX_SIDE_PX = 16_384
"""Longest side that is decoded; ``cv2.remap`` itself ends at 32 767."""
_MAX_PIXELS = 1 << 27
"""Most pixels that are decoded: 16 384 x 8192, 400 MB in colour."""
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
"""What files begin with: JPEG's start of image and the next marker; PNG's signature (ISO/IEC 15948, 5.2)."""
_END_OF_IMAGE = 0xD9
"""JPEG's last marker (ITU-T T.81, table B.1)."""
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)
"""A marker is ff and a code; 00 (a stuffed data byte), ff (fill) and d0-d7 (restarts) stand inside a scan."""
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Frame headers c0-cf, without the tables c4, c8 and cc that lie between them (the same table)."""


class ImageHeader(NamedTuple):
    """Size and state of an image file."""

    width: int
    """In pixels."""
    height: int
    """In pixels."""
    complete: bool
    """Whether the file reaches its own end."""


def read_header(content: bytes) -> ImageHeader | None:
    """Return what a JPEG or PNG file states about itself.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    ImageHeader or None
        None where it is neither, or where it ends before its size is stated.
    """
    if content.startswith(_JPEG):
        return _read_jpeg(content)
    if content.startswith(_PNG):
        return _read_png(content)
    return None


def _read_jpeg(content: bytes) -> ImageHeader | None:
    size: tuple[int, int] | None = None
    for marker, payload in _jpeg_segments(content):
        if marker in _JPEG_FRAMES and size is None and len(payload) >= 5:
            # One byte of sample precision, then height and width.
            size = int.from_bytes(payload[3:5], "big"), int.from_bytes(payload[1:3], "big")
        if marker == _END_OF_IMAGE and size is not None:
            return ImageHeader(*size, complete=True)
    return None if size is None else ImageHeader(*size, complete=False)


def _jpeg_segments(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield marker and payload of each segment up to the end marker, if there is one."""
    at = 2
    while found := _JPEG_MARKER.search(content, at):
        marker, at = found[1][0], found.end()
        if marker == _END_OF_IMAGE:
            yield marker, b""
            return
        length = max(int.from_bytes(content[at : at + 2], "big"), 2)
        yield marker, content[at + 2 : at + length]
        at += length


def _read_png(content: bytes) -> ImageHeader | None:
    if content[12:16] != b"IHDR" or len(content) < 24:
        return None
    width, height = int.from_bytes(content[16:20], "big"), int.from_bytes(content[20:24], "big")
    return ImageHeader(width, height, complete=_png_is_complete(content))


def _png_is_complete(content: bytes) -> bool:
    at, view = len(_PNG), memoryview(content)
    while at + 12 <= len(content):
        end = at + 8 + int.from_bytes(content[at : at + 4], "big")
        if zlib.crc32(view[at + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            return False
        if content[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


class ImageError(InputError):
    """An image that is missing, damaged, too large, or not of the camera's size."""


def read_image(path: Path, size: tuple[int, int] | None = None, *, gray: bool = False) -> Image:
    """Read a JPEG or PNG file; its pixels as the camera wrote them, whatever its EXIF orientation is.

    Size and completeness are read from the file's own structure first: a huge or truncated file is never
    decoded. Damage inside the compressed data of a complete JPEG file cannot be seen that way.

    Parameters
    ----------
    path : Path
        The file.
    size : (width, height), optional
        The camera's, in pixels.
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
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and width * height <= _MAX_PIXELS):
        raise ImageError(
            f"{path}: is {width} x {height} px; expected at most {MAX_SIDE_PX} px a side and {_MAX_PIXELS} px in all"
        )
    if size is not None and (width, height) != size:
        raise ImageError(f"{path}: is {width} x {height} px, the camera is {size[0]} x {size[1]} px")
    if not complete:
        raise ImageError(f"{path}: is truncated or damaged; expected all of the image")


def write_image(path: Path, image: Image, *, quality: int = 95) -> None:
    """Write an image whole or not at all, in the format that its name asks for.

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
