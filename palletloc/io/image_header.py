"""What an image file says about itself before it is decoded: its size, and whether all of it is there.

Decoders differ in what they do with a file that was cut off (some fill the rest with gray), so the
structure is walked here: the marker segments of a JPEG file up to its end marker, the chunks of a PNG file
with their check sums up to the last one.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from typing import NamedTuple

_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
_END_OF_IMAGE = 0xD9
# A marker is ff and a code; 00 (a stuffed data byte), ff (fill) and d0-d7 (restarts) stand inside a scan.
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)
# Frame headers c0-cf, without the tables c4, c8 and cc that lie between them.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class ImageHeader(NamedTuple):
    """Size and state of an image file."""

    width: int
    """In pixels."""
    height: int
    """In pixels."""
    complete: bool
    """Whether the file reaches its own end."""


def read_header(content: bytes) -> ImageHeader | None:
    """Return what a JPEG or PNG file says about itself.

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
