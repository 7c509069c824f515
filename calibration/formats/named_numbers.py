"""Cameras whose numbers have names: one table of programs, and one reader.

fisheye-calib-adapter (parameter files); CamOdoCal and VINS (``camera_models``); COLMAP (``cameras.txt``, and the
models of ``src/colmap/sensor/models``); nerfstudio and instant-ngp (``transforms.json``); Metashape (calibration XML
and the user manual's "Camera models"); ORB-SLAM 2 and 3, stella_vslam (settings). COLMAP, nerfstudio and Metashape
have the corner of the image at (0, 0), so that its first pixel's middle is at (0.5, 0.5); the others have that at
(0, 0), as we do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from calibration.formats.camera_file import FiledCamera, alone, filed_lens
from calibration.formats.fields import Fields
from calibration.formats.general_lens import GeneralLens, filed_general
from calibration.formats.ocam import camodocal_ocam
from calibration.formats.syntax import TABLE
from calibration.lenses.models import MODELS
from palletloc.cameras import Equirectangular
from palletloc.errors import nearest_name

_LENS = ("fx", "fy", "cx", "cy")
"""Names that most programs give focal lengths and centre."""
_ONE_FOCAL = ("f", "f", "cx", "cy")
"""The same of those with one focal length."""
_HALF_PIXEL = "its centre is half a pixel less here, where the first pixel's middle is at 0, not at 0.5"
"""What is said of programs that have it there."""
PANORAMA, _SCARAMUZZA = "equirectangular", "scaramuzza"
"""Kinds of numbers that describe no lens by a formula: a stitched panorama, and OCamCalib's polynomials."""


@dataclass(frozen=True, slots=True)
class _Numbers:
    """What a model of a program is, and how its numbers are called there."""

    kind: str
    """A model of ours, a projection of `GeneralLens`, or one of the kinds above."""
    lens: tuple[str, ...] = _LENS
    """fx, fy, cx, cy."""
    terms: tuple[str, ...] = ()
    """The others of a model of ours, in its order, or the radial ones of a projection."""
    more: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names of other fields of `GeneralLens`."""
    successive: bool = False
    """As `GeneralLens` has it."""


@dataclass(frozen=True, slots=True)
class _Program:
    """How a program writes a camera."""

    keys: tuple[str, ...]
    """What tells it: all are there."""
    size: tuple[str, str]
    """Keys of width and height."""
    models: Mapping[str, _Numbers]
    """By what the key of the model says."""
    model: str = ""
    """The key of the model; without one, the model is the one whose numbers are there."""
    default: str = ""
    """The model where the key is missing."""
    optional: bool = False
    """Whether a number that is not there is zero."""
    first_pixel: float = 0.0
    """Where the middle of the first pixel is."""


def _radial(count: int, prefix: str = "k", start: int = 1) -> tuple[str, ...]:
    return tuple(f"{prefix}{i}" for i in range(start, start + count))


_TANGENTIAL = {"tangential": ("p1", "p2")}
"""Decentring in OpenCV's order."""
_COLMAP = {
    "SIMPLE_PINHOLE": _Numbers("perspective", _ONE_FOCAL),
    "PINHOLE": _Numbers("perspective"),
    "SIMPLE_RADIAL": _Numbers("perspective", _ONE_FOCAL, ("k",)),
    "RADIAL": _Numbers("perspective", _ONE_FOCAL, _radial(2)),
    "OPENCV": _Numbers("perspective", _LENS, _radial(2), _TANGENTIAL),
    "FULL_OPENCV": _Numbers(
        "perspective", _LENS, _radial(2), {**_TANGENTIAL, "radial": ("k3",), "divisor": ("k4", "k5", "k6")}
    ),
    "BROWN_CONRADY": _Numbers("perspective", _ONE_FOCAL, _radial(3), _TANGENTIAL),
    "FOV": _Numbers("fov", _LENS, (), {"shape": ("omega",)}),
    "SIMPLE_DIVISION": _Numbers("division", _ONE_FOCAL, (), {"shape": ("k",)}),
    "DIVISION": _Numbers("division", _LENS, (), {"shape": ("k",)}),
    "SIMPLE_FISHEYE": _Numbers("equidistant", _ONE_FOCAL),
    "FISHEYE": _Numbers("equidistant"),
    "SIMPLE_RADIAL_FISHEYE": _Numbers("equidistant", _ONE_FOCAL, ("k",)),
    "RADIAL_FISHEYE": _Numbers("equidistant", _ONE_FOCAL, _radial(2)),
    "OPENCV_FISHEYE": _Numbers("equidistant", _LENS, _radial(4)),
    "THIN_PRISM_FISHEYE": _Numbers(
        "equidistant", _LENS, _radial(2), {**_TANGENTIAL, "radial": ("k3", "k4"), "prism": ("sx1", "", "sy1", "")}
    ),
    "RAD_TAN_THIN_PRISM_FISHEYE": _Numbers(
        "equidistant",
        _LENS,
        _radial(6, start=0),
        {"tangential": ("p1", "p0"), "prism": ("s0", "s1", "s2", "s3")},
        successive=True,
    ),
    "EUCM": _Numbers("eucm", _LENS, ("alpha", "beta")),
    "EQUIRECTANGULAR": _Numbers(PANORAMA, ("w", "h")),
}
"""COLMAP's models; their numbers stand in the file in the order of these names."""
_NERF_LENS = ("fl_x", "fl_y", "cx", "cy")
"""Names of nerfstudio."""
_METASHAPE = {"tangential": ("p2", "p1"), "skew": ("b2",)}
"""Metashape's p1 goes with r^2 + 2 x^2, which is OpenCV's p2; b1 is added to the focal length along columns."""
_SLAM = {"perspective": (*_radial(3), "p1", "p2"), "fisheye": _radial(4)}
"""Names of the distortions of ORB-SLAM and stella_vslam."""


def _slam(camera: str) -> dict[str, _Numbers]:
    """Return the models of ORB-SLAM and stella_vslam, with the key of the camera before each name."""
    lens = tuple(f"{camera}.{name}" for name in _LENS)
    radial, tangential = (tuple(f"{camera}.{name}" for name in names) for names in (_radial(4), ("p1", "p2")))
    flat = _Numbers("perspective", lens, radial[:3], {"tangential": tangential})
    fisheye = _Numbers("equidistant", lens, radial)
    return {
        **dict.fromkeys(("PinHole", "Pinhole", "perspective"), flat),
        **dict.fromkeys(("KannalaBrandt8", "fisheye"), fisheye),
        "equirectangular": _Numbers(PANORAMA, ()),
    }


def _under(place: str, names: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"{place}.{name}" for name in names)


_ADAPTER = {name: MODELS[name].shape for name in ("kannala_brandt", "pinhole", "double_sphere", "eucm")}
"""Models of fisheye-calib-adapter that are told by the names of their numbers."""
_IN, _ON = "projection_parameters", "distortion_parameters"
"""Where CamOdoCal has them."""
_PROGRAMS = (
    _Program(
        ("model_type",),
        ("image_width", "image_height"),
        {
            "KANNALA_BRANDT": _Numbers(
                "kannala_brandt", _under(_IN, ("mu", "mv", "u0", "v0")), _under(_IN, _radial(4, start=2))
            ),
            "MEI": _Numbers(
                "mei",
                _under(_IN, ("gamma1", "gamma2", "u0", "v0")),
                ("mirror_parameters.xi", *_under(_ON, ("k1", "k2", "p1", "p2"))),
            ),
            "PINHOLE": _Numbers(
                "perspective", _under(_IN, _LENS), _under(_ON, _radial(2)), {"tangential": _under(_ON, ("p1", "p2"))}
            ),
            "PINHOLE_FULL": _Numbers(
                "perspective",
                _under(_IN, _LENS),
                _under(_ON, _radial(3)),
                {"tangential": _under(_ON, ("p1", "p2")), "divisor": _under(_ON, _radial(3, start=4))},
            ),
            "SCARAMUZZA": _Numbers(_SCARAMUZZA, ()),
        },
        "model_type",
    ),
    _Program(
        ("calibration.projection",),
        ("calibration.width", "calibration.height"),
        {
            **{
                name: _Numbers(
                    kind,
                    _under("calibration", _ONE_FOCAL),
                    _under("calibration", _radial(4)),
                    {key: _under("calibration", names) for key, names in _METASHAPE.items()},
                )
                for name, kind in (
                    ("frame", "perspective"),
                    ("fisheye", "equidistant"),
                    ("equidistant_fisheye", "equidistant"),
                    ("equisolid_fisheye", "equisolid"),
                )
            },
            "spherical": _Numbers(PANORAMA, ()),
        },
        "calibration.projection",
        optional=True,
        first_pixel=0.5,
    ),
    _Program(
        ("fl_x",),
        ("w", "h"),
        {
            **dict.fromkeys(
                ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"),
                _Numbers("perspective", _NERF_LENS, _radial(4), _TANGENTIAL),
            ),
            **dict.fromkeys(
                ("OPENCV_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
                _Numbers("equidistant", _NERF_LENS, _radial(4)),
            ),
            "EQUIRECTANGULAR": _Numbers(PANORAMA, ()),
        },
        "camera_model",
        "OPENCV",
        optional=True,
        first_pixel=0.5,
    ),
    *(
        _Program((key,), (f"{camera}.{width}", f"{camera}.{height}"), _slam(inner), model, "PinHole", optional=True)
        for key, camera, inner, (width, height), model in (
            ("Camera1.fx", "Camera", "Camera1", ("width", "height"), "Camera.type"),
            ("Camera.cols", "Camera", "Camera", ("cols", "rows"), "Camera.model"),
            ("Camera.fx", "Camera", "Camera", ("width", "height"), "Camera.type"),
        )
    ),
    _Program(
        ("image", "parameter"),
        ("image.width", "image.height"),
        {
            **{
                name: _Numbers(name, _under("parameter", _LENS), _under("parameter", terms))
                for name, terms in _ADAPTER.items()
            },
            "plain pinhole": _Numbers("perspective", _under("parameter", _LENS)),
            "UCM": _Numbers("ucm", _under("parameter", _LENS), ("parameter.alpha",)),
        },
    ),
)
"""The programs, but for COLMAP, whose files are tables; told by their keys, in this order."""


def reads_named(fields: Fields) -> bool:
    """Return whether one of the programs wrote a file."""
    return _is_colmap(fields) or any(all(fields.has(key) for key in program.keys) for program in _PROGRAMS)


def _is_colmap(fields: Fields) -> bool:
    if not fields.has(TABLE):
        return False
    words = fields.value[TABLE][0]["words"]
    return len(words) > 3 and words[1].isupper() and words[2].isdigit()


def read_named(fields: Fields) -> list[FiledCamera]:
    """Return the cameras of a file of one of the programs; argument and errors as for `read_basalt`."""
    if _is_colmap(fields):
        return [replace(_colmap_camera(fields, row), placed=False) for row in fields.value[TABLE]]
    program = next(program for program in _PROGRAMS if all(fields.has(key) for key in program.keys))
    return [_camera(fields, program, _numbers(fields, program), "camera")]


def _colmap_camera(fields: Fields, row: Mapping[str, Any]) -> FiledCamera:
    number, *words = row["words"]
    place = Fields(fields.path, f"line {row['line']}", {})
    if len(words) < 3 or words[0] not in _COLMAP:
        kind = words[0] if words else ""
        raise place.wrong(f"unknown camera model '{kind}'{nearest_name(kind, _COLMAP)}")
    numbers = _COLMAP[words[0]]
    names = [name for name in _colmap_order(numbers) if name]
    if len(words) != 3 + len(names):
        raise place.wrong(f"expected the {len(names)} numbers {', '.join(names)} of {words[0]}, got {len(words) - 3}")
    values = dict(zip(("width", "height", *names), words[1:], strict=True))
    program = _Program((), ("width", "height"), {}, first_pixel=0.5)
    return _camera(replace(place, value=values), program, numbers, f"camera {number}")


def _colmap_order(numbers: _Numbers) -> tuple[str, ...]:
    lens = dict.fromkeys(numbers.lens)
    # One model has the second of the tangential numbers first.
    more = {**numbers.more, "tangential": sorted(numbers.more.get("tangential", ()))}
    return (*lens, *numbers.terms, *(name for names in more.values() for name in names))


def _numbers(fields: Fields, program: _Program) -> _Numbers:
    """Return the model of a file."""
    if program.model:
        if fields.has("is_fisheye") and fields.at("is_fisheye").value:
            return program.models["OPENCV_FISHEYE"]
        if program.default and not fields.has(program.model):
            return program.models[program.default]
        return program.models[fields.at(program.model).text(tuple(program.models))]
    given = fields.at("parameter")
    there = set(given.value) if isinstance(given.value, dict) else set()
    for numbers in program.models.values():
        if there == {name.rpartition(".")[2] for name in (*numbers.lens, *numbers.terms)}:
            return numbers
    forms = "; ".join(
        f"{', '.join(name.rpartition('.')[2] for name in numbers.terms) or 'nothing else'} ({model})"
        for model, numbers in program.models.items()
    )
    raise given.fault(f"fx, fy, cx, cy and one of {forms}")


def _camera(fields: Fields, program: _Program, numbers: _Numbers, name: str) -> FiledCamera:
    width, height = (fields.at(key).side() for key in program.size)
    if numbers.kind == PANORAMA:
        if width != 2 * height:
            raise fields.wrong(f"is a panorama of {width} x {height} px; expected twice as wide as high")
        return alone(name, Equirectangular(width, height))
    if numbers.kind == _SCARAMUZZA:
        return alone(name, camodocal_ocam(fields, (width, height)))

    def values(names: Iterable[str], *, optional: bool = program.optional) -> tuple[float, ...]:
        return tuple(fields.at(key).number() if key and (not optional or fields.has(key)) else 0.0 for key in names)

    metashape = fields.has("calibration.f")
    fx, fy, cx, cy = (*values(numbers.lens[:2], optional=False), *values(numbers.lens[2:], optional=metashape))
    lens: tuple[float, ...] = fx, fy, cx - program.first_pixel, cy - program.first_pixel
    if metashape:
        lens = _metashape_lens(fields, lens, (width, height))
    terms = values(numbers.terms)
    if numbers.kind == "ucm":
        return alone(name, filed_lens(fields, "eucm", (width, height), lens, (*terms, 1.0)))
    if numbers.kind in MODELS:
        return alone(name, filed_lens(fields, numbers.kind, (width, height), lens, terms))
    more: dict[str, Any] = {key: values(names) for key, names in numbers.more.items()}
    terms += more.pop("radial", ())
    for key in ("shape", "skew"):
        if key in more:
            more[key] = more[key][0]
    general = GeneralLens(numbers.kind, width, height, lens, terms, **more, successive=numbers.successive)
    filed = filed_general(fields, name, general)
    return _noted(filed) if program.first_pixel else filed


def _noted(filed: FiledCamera) -> FiledCamera:
    """Return a camera with the note on its centre."""
    return replace(filed, note=f"{filed.note}; {_HALF_PIXEL}" if filed.note else _HALF_PIXEL)


def _metashape_lens(fields: Fields, lens: tuple[float, ...], size: tuple[int, int]) -> tuple[float, ...]:
    """Return fx, fy, cx, cy from a focal length, its excess along columns, and a centre off the image's middle."""
    for key in ("p3", "p4"):
        if fields.has(f"calibration.{key}") and fields.at(f"calibration.{key}").number():
            raise fields.at(f"calibration.{key}").wrong("has no form here; expected 0: export without p3 and p4")
    excess = fields.at("calibration.b1").number() if fields.has("calibration.b1") else 0.0
    return lens[0] + excess, lens[1], lens[2] + size[0] / 2, lens[3] + size[1] / 2
