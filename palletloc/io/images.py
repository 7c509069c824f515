"""Reading and writing shots, with guards against what is not one."""

from __future__ import annotations

import os
import re
import threading
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from palletloc.geometry import Image
from palletloc.io.atomic import write_bytes
from palletloc.io.image_headers import foreign_kind, read_header
from palletloc.io.panorama import panorama_fault
from palletloc.io.reading import InputError, read_bytes

MAX_SIDE_PX = 16_384
"""Longest side that is decoded; ``cv2.remap`` itself ends at 32 767."""
_MAX_PIXELS = 1 << 27
"""Most pixels that are decoded: 16 384 x 8192, 400 MB in colour."""
_READ_TOO = "WebP, TIFF, BMP and JPEG 2000 are read, too"
"""What a message about other files adds."""
_DAMAGE = re.compile(r"Corrupt JPEG data.*|Premature end of JPEG file.*|Inconsistent progression.*|Invalid SOS.*")
"""libjpeg's warnings about data that are not what the encoder wrote (its jerror.h); the others concern headers."""
_DECODER = re.compile(
    rf"{_DAMAGE.pattern}|Unknown Adobe.*|Warning: unknown JFIF.*|Application transferred.*|\[ *(WARN|ERROR|INFO):.*|"
)
"""Lines that decoders write to standard error: libjpeg's, and OpenCV's log."""
_STANDARD_ERROR = 2
"""Its file descriptor."""
_MOST_SAID = 1 << 16
"""How many bytes of what a decoder says are kept: what a pipe holds."""
_ONE_AT_A_TIME = threading.Lock()
"""Held while standard error is taken: it belongs to the whole process."""


class ImageError(InputError):
    """An image that is missing, damaged, too large, or not of the camera's size."""


def read_image(
    path: Path, size: tuple[int, int] | None = None, *, gray: bool = False, panorama: bool = False
) -> Image:
    """Read an image file; its pixels as the camera wrote them, whatever its EXIF orientation is.

    Size and completeness are read from the file's own structure first: a huge or truncated file is never
    decoded. What JPEG's decoder warns of counts as damage; bits that were changed to others that make sense
    cannot be seen.

    Parameters
    ----------
    path : Path
        The file: JPEG, PNG, WebP, TIFF, BMP or JPEG 2000, whatever its name.
    size : (width, height), optional
        The camera's, in pixels.
    gray : bool
        Whether to decode to gray, which is faster.
    panorama : bool
        Whether a file that states another projection than the equirectangular one is refused.

    Returns
    -------
    (height, width, 3) or (height, width) array of uint8
        In blue-green-red order, or gray.

    Raises
    ------
    ImageError
        If the file is missing, is not such an image, is cut off or damaged, has another or too large a size, or
        is a part of a panorama.
    """
    try:
        content = read_bytes(path)
    except InputError as error:
        raise ImageError(str(error)) from error
    _check_content(path, content, size)
    if (fault := panorama_fault(content, any_projection=not panorama)) is not None:
        raise ImageError(f"{path}: {fault}")
    flag = cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR
    image, said = _decoded(content, flag | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise ImageError(f"{path}: is damaged, it cannot be decoded")
    if (damage := _DAMAGE.search(said)) is not None:
        raise ImageError(f"{path}: is damaged, parts of it show nothing or something else ({damage[0].strip()})")
    return np.asarray(image, dtype=np.uint8)


def _decoded(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """Decode an image, and return what the decoder said: OpenCV hands its warnings to standard error only."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)  # what is too long for the pipe is lost
    with _ONE_AT_A_TIME:
        try:
            terminal = os.dup(_STANDARD_ERROR)
        except OSError:  # a service may have none
            terminal = None
        os.dup2(writing, _STANDARD_ERROR)
        os.close(writing)
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        except cv2.error:
            image = None
        finally:
            if terminal is None:
                os.close(_STANDARD_ERROR)
            else:
                os.dup2(terminal, _STANDARD_ERROR)
                os.close(terminal)
            with os.fdopen(reading, "rb") as pipe:
                said = pipe.read(_MOST_SAID).decode("utf-8", "replace")
    _pass_on(said)
    return image, said


def _pass_on(said: str) -> None:
    """Write to standard error what others wrote to it while an image was decoded."""
    rest = [line for line in said.splitlines(keepends=True) if not _DECODER.fullmatch(line.strip())]
    with suppress(OSError):
        os.write(_STANDARD_ERROR, "".join(rest).encode())


def _check_content(path: Path, content: bytes, size: tuple[int, int] | None) -> None:
    """Raise an error where the content should not be decoded."""
    if not content:
        raise ImageError(f"{path}: is empty; expected a JPEG or PNG image")
    header = read_header(content)
    if header is None:
        kind = foreign_kind(content)
        what = f" but {kind}; {_READ_TOO}" if kind else ", or is cut off before its size"
        raise ImageError(f"{path}: is not a JPEG or PNG image{what}")
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
