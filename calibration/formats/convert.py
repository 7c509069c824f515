"""The command ``palletloc calibrate convert``: camera files from one program's form to another's."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.formats import basalt, camera_matrix, kalibr, ocam
from calibration.formats.any_format import read_cameras as read_cameras
from calibration.formats.camera_file import FiledCamera, alone, camera_text, side_by_side
from calibration.lenses.conversion import ConversionError, LensDifference, convert_lens, difference
from calibration.lenses.models import MODELS, lens_model, model_of
from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, KannalaBrandt
from palletloc.errors import PalletLocError, nearest_name
from palletloc.io.atomic import write_text

_DUAL = "dual_fisheye"
"""Name of the model of two fisheyes side by side."""
_YAML = (".yaml", ".yml")
"""Endings of yaml files."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """What was converted."""

    names: tuple[str, ...]
    """Of the cameras."""
    source: str
    """Model of the first one."""
    target: str
    """Its model in the file that was written."""
    differences: tuple[LensDifference, ...]
    """Of each camera: the written file against the one that was read."""
    notes: tuple[str, ...] = ()
    """What was decided when the file was read, each with its camera."""


@dataclass(frozen=True, slots=True)
class _Format:
    models: tuple[str, ...]
    suffixes: tuple[str, ...]
    text: Callable[[Sequence[FiledCamera], Path], str]


def _single(cameras: Sequence[FiledCamera]) -> FiledCamera:
    if len(cameras) > 1:
        raise PalletLocError(
            f"the format holds one camera, there are {len(cameras)}; expected --camera with its number"
        )
    return cameras[0]


def _ocam_text(cameras: Sequence[FiledCamera], _: Path) -> str:
    camera = _single(cameras).camera
    if isinstance(camera, ocam.OcamCamera):
        return ocam.ocam_text(camera)
    if not isinstance(camera, KannalaBrandt):
        raise ValueError(f"OCamCalib has no form for this {type(camera).__name__}")
    return ocam.ocam_text(ocam.ocam_camera(camera))


_FORMATS = {
    "palletloc": _Format((*MODELS, _DUAL), _YAML, lambda cameras, _: camera_text(_single(cameras).camera)),
    "kalibr": _Format(kalibr.MODELS, _YAML, lambda cameras, _: kalibr.kalibr_text(cameras)),
    "basalt": _Format(basalt.MODELS, (".json",), lambda cameras, _: basalt.basalt_text(cameras)),
    "ros": _Format(
        camera_matrix.ROS_MODELS,
        _YAML,
        lambda cameras, _: camera_matrix.camera_info_text(_single(cameras).camera, cameras[0].name),
    ),
    "opencv": _Format(
        camera_matrix.OPENCV_MODELS,
        (".xml", ".yml", ".yaml", ".json"),
        lambda cameras, out: camera_matrix.opencv_text(_single(cameras).camera, out.suffix.lower()),
    ),
    "ocam": _Format(ocam.MODELS, (".txt",), _ocam_text),
}
"""The forms that can be written, by name."""


def convert_camera(
    source: Path, target: str, out: Path, number: int | None = None, max_angle: float = np.pi
) -> Conversion:
    """Convert a camera file, and compare what was written with what was read.

    Parameters
    ----------
    source : Path
        The file to read.
    target : str
        ``FORMAT`` or ``FORMAT/MODEL``.
    out : Path
        The file to write.
    number : int, optional
        Which camera of several, from 0 on.
    max_angle : float
        Largest angle off axis that counts, in radians.

    Raises
    ------
    PalletLocError
        If the file is wrong, a name is unknown, the model cannot hold the camera, or nothing can be written.
    """
    form, model = _target(target, out)
    cameras = read_cameras(source)
    if number is not None:
        if not 0 <= number < len(cameras):
            raise PalletLocError(f"--camera {number}: {source} has the cameras 0 to {len(cameras) - 1}")
        cameras = [alone(cameras[number].name, cameras[number].camera, cameras[number].note)]
    if len(cameras) > 1 and not all(filed.placed for filed in cameras):
        raise PalletLocError(
            f"{source}: does not say where its {len(cameras)} cameras are against each other; expected --camera with"
            f" one of 0 to {len(cameras) - 1}"
        )
    if model == _DUAL:
        return _pair(source, cameras, out)
    converted = [_converted(filed, form, model, max_angle) for filed in cameras]
    text = _text(form, converted, out)
    with tempfile.TemporaryDirectory() as folder:
        beside = Path(folder) / out.name
        write_text(beside, text)
        again = read_cameras(beside)
    left = tuple(
        difference(filed.camera, written.camera, min(max_angle, _reach(to.camera)))
        for filed, to, written in zip(cameras, converted, again, strict=True)
        if not isinstance(filed.camera, DualFisheye | Equirectangular)
    )
    write_text(out, text)
    names = tuple(filed.name for filed in cameras)
    notes = tuple(f"{filed.name}: {filed.note}" for filed in cameras if filed.note)
    return Conversion(names, _name(cameras[0].camera), _name(again[0].camera), left, notes)


def _target(target: str, out: Path) -> tuple[str, str | None]:
    """Return format and model that a target names."""
    form, _, model = target.partition("/")
    if form not in _FORMATS:
        raise PalletLocError(f"--to {target}: unknown format '{form}'{nearest_name(form, _FORMATS)}")
    if model and model not in _FORMATS[form].models:
        raise PalletLocError(
            f"--to {target}: {form} has no model '{model}'{nearest_name(model, _FORMATS[form].models)}"
        )
    if out.suffix.lower() not in _FORMATS[form].suffixes:
        raise PalletLocError(f"--out {out}: expected a name that ends in {' or '.join(_FORMATS[form].suffixes)}")
    return form, model or None


def _pair(source: Path, cameras: Sequence[FiledCamera], out: Path) -> Conversion:
    dual = side_by_side(*cameras) if len(cameras) == 2 else None
    if dual is None:
        raise PalletLocError(f"{source}: expected two kannala_brandt cameras with images of one height")
    write_text(out, camera_text(dual))
    return Conversion(tuple(filed.name for filed in cameras), _name(cameras[0].camera), _DUAL, ())


def _converted(filed: FiledCamera, form: str, model: str | None, max_angle: float) -> FiledCamera:
    """Return a camera in the model that is asked for, or in one that the format can hold."""
    own = model_of(filed.camera)
    if model is None:
        keeps = form == "palletloc" and isinstance(filed.camera, Equirectangular)
        if keeps or (form == "ocam" and isinstance(filed.camera, ocam.OcamCamera)):
            return filed
        model = own.name if own is not None and own.name in _FORMATS[form].models else _FORMATS[form].models[0]
    if isinstance(filed.camera, Equirectangular):
        raise ConversionError(f"a stitched panorama has no form in {form}/{model}")
    return FiledCamera(filed.name, convert_lens(filed.camera, lens_model(model), max_angle), filed.first_from_camera)


def _text(form: str, cameras: Sequence[FiledCamera], out: Path) -> str:
    try:
        return _FORMATS[form].text(cameras, out)
    except ValueError as error:
        raise ConversionError(f"{error}; expected one of the models {', '.join(_FORMATS[form].models)}") from None


def _reach(camera: CameraModel) -> float:
    """Return how far off axis a camera sees by itself, as far as it says so."""
    return float(getattr(camera, "max_angle", np.pi))


def _name(camera: CameraModel) -> str:
    model = model_of(camera)
    return model.name if model is not None else type(camera).__name__.removesuffix("Camera").lower()
