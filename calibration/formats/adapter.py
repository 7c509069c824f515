"""The parameter files of fisheye-calib-adapter: one camera, whose model only the names of its numbers tell."""

from __future__ import annotations

from calibration.formats.camera_file import FiledCamera, alone, built, fisheye
from calibration.formats.fields import Fields
from palletloc.cameras import CameraModel, DoubleSphere, Eucm, Pinhole

_LENS = ("fx", "fy", "cx", "cy")
"""Keys that all models have."""
_TERMS = {
    "kannala_brandt": ("k1", "k2", "k3", "k4"),
    "pinhole": ("k1", "k2", "p1", "p2", "k3"),
    "double_sphere": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
}
"""The other keys of each model."""


def read_adapter(fields: Fields) -> list[FiledCamera]:
    """Return the camera of a file with the keys ``image`` and ``parameter``.

    Parameters
    ----------
    fields : Fields
        The whole file.

    Raises
    ------
    FormatError
        If it does not hold what the format says.
    """
    image, given = fields.at("image"), fields.at("parameter")
    size = image.at("width").side(), image.at("height").side()
    keys = set(given.value) - set(_LENS) if isinstance(given.value, dict) else set()
    model = next((name for name, terms in _TERMS.items() if keys == set(terms)), None)
    if model is None:
        forms = "; ".join(f"{', '.join(terms)} ({name})" for name, terms in _TERMS.items())
        raise given.fault(f"fx, fy, cx, cy and one of {forms}")
    fx, fy, cx, cy = (given.at(key).number() for key in _LENS)
    terms = [given.at(key).number() for key in _TERMS[model]]
    return [alone("camera", _built(given, model, size, (fx, fy, cx, cy), terms))]


def _built(
    fields: Fields, model: str, size: tuple[int, int], lens: tuple[float, float, float, float], terms: list[float]
) -> CameraModel:
    match model:
        case "kannala_brandt":
            return fisheye(fields, size, lens, terms)
        case "pinhole":
            return built(fields, lambda: Pinhole(*size, *lens, *terms))
        case "double_sphere":
            return built(fields, lambda: DoubleSphere(*size, *lens, *terms))
        case _:
            return built(fields, lambda: Eucm(*size, *lens, *terms))
