"""The parameter files of fisheye-calib-adapter: one camera, whose model only the names of its numbers tell."""

from __future__ import annotations

from calibration.formats.camera_file import FiledCamera, alone, filed_lens
from calibration.formats.fields import Fields
from calibration.lenses.models import MODELS

_LENS = ("fx", "fy", "cx", "cy")
"""Keys that all models have."""
_TERMS = {name: MODELS[name].shape for name in ("kannala_brandt", "pinhole", "double_sphere", "eucm")}
"""The other keys of each model."""


def read_adapter(fields: Fields) -> list[FiledCamera]:
    """Return the camera of a file with ``image`` and ``parameter``; argument and errors as for `read_basalt`."""
    image, given = fields.at("image"), fields.at("parameter")
    size = image.at("width").side(), image.at("height").side()
    keys = set(given.value) - set(_LENS) if isinstance(given.value, dict) else set()
    model = next((name for name, terms in _TERMS.items() if keys == set(terms)), None)
    if model is None:
        forms = "; ".join(f"{', '.join(terms)} ({name})" for name, terms in _TERMS.items())
        raise given.fault(f"fx, fy, cx, cy and one of {forms}")
    lens, terms = ([given.at(key).number() for key in keys] for keys in (_LENS, _TERMS[model]))
    return [alone("camera", filed_lens(given, model, size, lens, terms))]
