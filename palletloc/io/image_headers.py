"""What image files state of themselves, before anything is decoded: their size, and whether they reach their end."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
"""What files begin with: JPEG's start of image and the next marker; PNG's signature (ISO/IEC 15948, 5.2)."""
_JP2, _J2K = b"\x00\x00\x00\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51"
"""JPEG 2000: the signature box of a file (ISO/IEC 15444-1, I.5.1), and a codestream's SOC and SIZ (A.4, A.5)."""
_END_OF_IMAGE = 0xD9
"""JPEG's last marker (ITU-T T.81, table B.1); JPEG 2000 ends with the same code (ISO/IEC 15444-1, A.4.4)."""
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)
"""A marker is ff and a code; 00 (a stuffed data byte), ff (fill) and d0-d7 (restarts) stand inside a scan."""
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Frame headers c0-cf, without the tables c4, c8 and cc that lie between them (the same table)."""
_LOST = bytes(64)
"""Zeros where a disk or a network lost a part of the file. Data of a scan have no such run, unless its first table
says that zeros end a block (EOB): then a dark or flat part of the image has."""
_TIFF_SIZES = {3: 2, 4: 4, 16: 8}
"""Bytes of the field types of which sizes and places are made: SHORT, LONG (TIFF 6.0, p. 15) and BigTIFF's LONG8."""
_TIFF_PARTS = ((273, 279), (324, 325))
"""Tags with offsets and byte counts: of strips, of tiles (TIFF 6.0, p. 36 and 67)."""
_MOST_PARTS = 1 << 16
"""Most strips or tiles that are looked at."""
_OTHERS = {
    "a GIF image": rb"GIF8[79]a",
    "a HEIF or AVIF image": rb".{4}ftyp(heic|heix|mif1|msf1|avif|avis)",
    "a raw photograph": rb"(II\*\x00.{4}CR|IIRO|IIU\x00|FUJIFILMCCD-RAW)",
    "an OpenEXR image": rb"v/1\x01",
    "a Radiance HDR image": rb"#\?(RADIANCE|RGBE)",
    "a portable pixmap": rb"P[1-7]\s",
    "a video": rb".{4}ftyp|RIFF.{4}AVI |\x1aE\xdf\xa3",
    "a web page or XML": rb"\s*<",
    "a PDF document": rb"%PDF",
}
"""Files that are given for images now and then, by what they begin with."""


class ImageHeader(NamedTuple):
    """Size and state of an image file."""

    width: int
    """In pixels."""
    height: int
    """In pixels."""
    complete: bool
    """Whether the file reaches its own end."""


def read_header(content: bytes) -> ImageHeader | None:
    """Return what a JPEG, PNG, WebP, TIFF, BMP or JPEG 2000 file states about itself.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    ImageHeader or None
        None where it is none of these, or where it ends before its size is stated.
    """
    for signature, reader in _READERS:
        if re.match(signature, content, re.DOTALL):
            return reader(content)
    return None


def foreign_kind(content: bytes) -> str | None:
    """Return what a file is that is none of the images that are read, or None where that is not known."""
    return next((kind for kind, start in _OTHERS.items() if re.match(start, content, re.DOTALL)), None)


def _read_jpeg(content: bytes) -> ImageHeader | None:
    size: tuple[int, int] | None = None
    tables: dict[int, int] = {}
    scan, sequential, zeros_mean_nothing = 0, False, True
    for marker, payload, after in _jpeg_segments(content):
        if marker in _JPEG_FRAMES and size is None and len(payload) >= 5:
            # One byte of sample precision, then height and width.
            size = int.from_bytes(payload[3:5], "big"), int.from_bytes(payload[1:3], "big")
            sequential = marker in (0xC0, 0xC1)
        elif marker == 0xC4:
            tables.update(_first_symbols(payload))
        elif marker == 0xDA and not scan:
            scan, zeros_mean_nothing = after, not sequential or tables.get(payload[2] & 15 if payload[2:] else 0) == 0
        if marker == _END_OF_IMAGE and size is not None:
            return ImageHeader(*size, complete=zeros_mean_nothing or content.find(_LOST, scan, after) < 0)
    return None if size is None else ImageHeader(*size, complete=False)


def _first_symbols(payload: bytes) -> Iterator[tuple[int, int]]:
    """Yield number and first symbol, whose code is all zeros, of the AC tables of a DHT segment (T.81, B.2.4.2)."""
    at = 0
    while at + 17 < len(payload):
        if payload[at] >> 4:
            yield payload[at] & 15, payload[at + 17]
        at += 17 + sum(payload[at + 1 : at + 17])


def _jpeg_segments(content: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield marker and payload of each segment, and where it ends, up to the end marker, if there is one."""
    at = 2
    while found := _JPEG_MARKER.search(content, at):
        marker, at = found[1][0], found.end()
        if marker == _END_OF_IMAGE:
            yield marker, b"", at
            return
        length = max(int.from_bytes(content[at : at + 2], "big"), 2)
        yield marker, content[at + 2 : at + length], at + length
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


def _read_webp(content: bytes) -> ImageHeader | None:
    """Read the first chunk of a WebP file (RFC 9649): VP8X, VP8L or VP8."""
    if len(content) < 30:
        return None
    complete = len(content) >= 8 + int.from_bytes(content[4:8], "little")
    kind, size = content[12:16], content[24:30]
    if kind == b"VP8X":
        return ImageHeader(
            1 + int.from_bytes(size[:3], "little"), 1 + int.from_bytes(size[3:], "little"), complete=complete
        )
    if kind == b"VP8L":
        bits = int.from_bytes(content[21:25], "little")
        return ImageHeader(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF), complete=complete)
    # A key frame: three bytes of tag, three of start code, then 14 bits each of width and height.
    width, height = (int.from_bytes(content[at : at + 2], "little") & 0x3FFF for at in (26, 28))
    return ImageHeader(width, height, complete=complete) if kind == b"VP8 " else None


def _read_bmp(content: bytes) -> ImageHeader | None:
    """Read the headers of a bitmap: BITMAPFILEHEADER and BITMAPINFOHEADER, as Microsoft documents them."""
    if len(content) < 34 or int.from_bytes(content[14:18], "little") < 40:
        return None
    width, height = (int.from_bytes(content[at : at + 4], "little", signed=True) for at in (18, 22))
    bits, packing = int.from_bytes(content[28:30], "little"), int.from_bytes(content[30:34], "little")
    rows = abs(height) * ((width * bits + 31) // 32 * 4)
    # Run lengths (1, 2) have no known size: their own end is the file's.
    stated = int.from_bytes(content[2:6], "little") if packing in (1, 2) else 0
    end = max(int.from_bytes(content[10:14], "little") + (0 if packing in (1, 2) else rows), stated)
    return ImageHeader(width, abs(height), complete=len(content) >= end)


def _read_tiff(content: bytes) -> ImageHeader | None:
    """Read the first directory of a TIFF or BigTIFF file: its size, and whether all strips or tiles are there."""
    order: Literal["little", "big"] = "little" if content[:2] == b"II" else "big"
    big = int.from_bytes(content[2:4], order) == 43

    def number(at: int, size: int) -> int:
        return int.from_bytes(content[at : at + size], order)

    word, count_size, entry = (8, 8, 20) if big else (4, 2, 12)
    first = number(8 if big else 4, word)
    if first + count_size > len(content):
        return None
    tags: dict[int, list[int]] = {}
    for index in range(min(number(first, count_size), 4096)):
        at = first + count_size + index * entry
        size, count = _TIFF_SIZES.get(number(at + 2, 2), 0), number(at + 4, word)
        place = at + 4 + word
        if size * count > word:
            place = number(place, word)
        if size and count <= _MOST_PARTS and place + size * count <= len(content):
            tags[number(at, 2)] = [number(place + size * item, size) for item in range(count)]
    if not tags.get(256) or not tags.get(257):
        return None
    parts = next(((tags[start], tags[size]) for start, size in _TIFF_PARTS if start in tags and size in tags), None)
    complete = parts is not None and all(sum(part) <= len(content) for part in zip(*parts, strict=False))
    return ImageHeader(tags[256][0], tags[257][0], complete=complete)


def _read_jpeg2000(content: bytes) -> ImageHeader | None:
    """Read a JPEG 2000 codestream, alone or in the boxes of a file: its SIZ, and whether it ends with EOC."""
    start = content.find(_J2K)
    if start < 0 or start + 24 > len(content):
        return None
    # SIZ: after marker, length and capabilities the far corner of the image, and its near one.
    right, bottom, left, top = (int.from_bytes(content[at : at + 4], "big") for at in range(start + 8, start + 24, 4))
    complete = content.rfind(bytes([0xFF, _END_OF_IMAGE])) > start
    return ImageHeader(right - left, bottom - top, complete=complete)


_READERS: tuple[tuple[bytes, Callable[[bytes], ImageHeader | None]], ...] = (
    (re.escape(_JPEG), _read_jpeg),
    (re.escape(_PNG), _read_png),
    (rb"RIFF.{4}WEBP", _read_webp),
    (rb"BM.{4}\x00{4}", _read_bmp),
    (rb"II[*+]\x00(?!.{4}CR)|MM\x00[*+]", _read_tiff),
    (re.escape(_JP2) + b"|" + re.escape(_J2K), _read_jpeg2000),
)
"""Signature of each kind of image that is read, and what reads its header."""
