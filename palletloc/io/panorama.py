"""What a panorama's file says of its projection: Google's Photo Sphere XMP metadata (GPano)."""

from __future__ import annotations

import re

_NAMESPACE = b"http://ns.google.com/photos/1.0/panorama/"
"""Of the metadata: https://developers.google.com/streetview/spherical-metadata."""
_REACH = 1 << 16
"""How many bytes around the namespace its values are looked for: an APP1 segment is no longer."""
_VALUE = re.compile(
    rb"""(?<![/\w.-])[\w.-]+:(ProjectionType|(?:FullPano|CroppedArea)\w+?Pixels)\s*(?:=\s*["']([^"'<]*)|>([^<]*)<)"""
)
"""A value, as an attribute or as an element."""


def panorama_fault(content: bytes, *, any_projection: bool = False) -> str | None:
    """Return why a file does not hold a whole equirectangular panorama, by what it says itself.

    Parameters
    ----------
    content : bytes
        The whole file, of any kind.
    any_projection : bool
        Whether only parts of panoramas are at fault, not other projections.

    Returns
    -------
    str or None
        What it is instead, and what to do; None where it is whole, or says nothing.
    """
    at = content.find(_NAMESPACE)
    if at < 0:
        return None
    said = {
        key.decode(): (first or second).decode("latin-1").strip()
        for key, first, second in _VALUE.findall(content[max(at - _REACH, 0) : at + _REACH])
    }
    projection = said.get("ProjectionType", "equirectangular")
    if projection.lower() != "equirectangular" and not any_projection:
        return f"says that its projection is {projection[:40]!r}; expected an equirectangular panorama"
    part, whole = _size(said, "CroppedAreaImage"), _size(said, "FullPano")
    if part is None or whole is None or part == whole:
        return None
    left, top = (_pixels(said.get(f"CroppedArea{side}Pixels", "")) or 0 for side in ("Left", "Top"))
    across, down = 360 * part[0] / max(whole[0], 1), 180 * part[1] / max(whole[1], 1)
    return (
        f"says that it is cropped: {part[0]} x {part[1]} px of a panorama of {whole[0]} x {whole[1]} px,"
        f" {across:.1f} x {down:.1f} degrees; expected all of it, or the part padded to that"
        f" size with {left} px on its left and {top} px above (and this metadata removed)"
    )


def _size(said: dict[str, str], key: str) -> tuple[int, int] | None:
    width, height = (_pixels(said.get(f"{key}{side}Pixels", "")) for side in ("Width", "Height"))
    return None if width is None or height is None else (width, height)


def _pixels(text: str) -> int | None:
    return round(float(text)) if re.fullmatch(r"\d{1,9}(\.\d{0,9})?", text) else None
