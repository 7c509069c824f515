"""Scenes that vary in everything a warehouse varies in, each thing drawn on its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.choices import CameraKind, Illumination, Side
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.prior import PriorConfig
from palletloc.synthetic.aisle import AisleSpec
from palletloc.synthetic.loads import Load
from palletloc.synthetic.rig import Sensor
from palletloc.synthetic.simulation import SimulatedOdometryNoise, SimulationSpec

_Kind = TypeVar("_Kind")

_STREAM = 1 << 20
"""Keeps these draws apart from those of the simulation, which begin at the same seed."""

_MODELS = {
    "epal1-1200": 0.24,
    "epal1-800": 0.24,
    "t11-plastic": 0.14,
    "t11": 0.08,
    "gma-1016": 0.08,
    "chep-us-1016": 0.06,
    "chep-us-1219": 0.06,
    "": 0.10,  # any other of the library
}
_TWO_MODELS = 0.25

_CAMERAS = {
    CameraKind.EQUIRECTANGULAR: 0.70,
    CameraKind.DUAL_FISHEYE: 0.12,
    CameraKind.KANNALA_BRANDT: 0.12,
    CameraKind.PINHOLE: 0.06,
}
FULL_WIDTH = {
    CameraKind.EQUIRECTANGULAR: 3840,
    CameraKind.DUAL_FISHEYE: 3840,
    CameraKind.KANNALA_BRANDT: 1920,
    CameraKind.PINHOLE: 1280,
}
"""Width of a full-size image of each kind of camera, in pixels: about ten pixels per degree beside the camera."""

_LOADS: tuple[tuple[Load, ...], ...] = (
    (Load.CARTONS, Load.CARTONS, Load.CARTONS, Load.WRAPPED, Load.CRATE, Load.NONE),
    (Load.NONE,),
    (Load.WRAPPED, Load.NONE),
    (Load.CRATE, Load.CARTONS),
)


@dataclass(frozen=True, slots=True)
class DrawnScene:
    """One approach to pallets."""

    seed: int
    """Gives the scene, and everything that the simulation draws."""
    full: bool
    """Whether the images have their full size rather than half of it."""
    spec: SimulationSpec
    """What to simulate."""


def draw_scene(seed: int, shots: int = 3, width: int | None = None) -> DrawnScene:
    """Draw a scene; equal seeds give equal scenes.

    Every part is drawn independently of the others, but for the levels, which follow the camera's height.

    ==================  =============================================================================
    pallets             one model of the library, in one scene of four two; the EPAL faces are frequent
    camera              mostly equirectangular; every second scene has images of half size
    mounting            1.3 to 2.2 m high, turned by up to 2 degrees, in one scene of five by up to 6
    shelf               left or right, 1.2 to 2.6 m from the path
    levels              the floor; one whose pallets are 0.2 to 0.4 m above or below the camera's height;
                        in one scene of three one whose pallets straddle it; in one of seven one above all
    known levels        off by as much as the localizer takes for granted
    light               one of each kind; in one scene of five too dark, in one of five too bright
    sensor              blur 0.4 to 1.5 px, noise 0.5 to 6 grey levels, JPEG 80 to 95, a falloff
    floor               glossy in one scene of two, with lines in two of three
    pallets' places     turned by up to 3 degrees (one sigma), set back by up to 40 mm (one sigma)
    pallets' shape      off by 0 to 1.5 times the model's tolerance (one sigma)
    occluders           posts and cartons before none to three pallets
    mounting's errors   those that the recording claims; in one scene of four none, and no claim
    nominal plane       off by up to 80 mm and 1.5 degrees
    odometry            0 to 1.5 times the usual errors
    ==================  =============================================================================

    Parameters
    ----------
    seed : int
        Not negative.
    shots : int
        How many, spread over the approach.
    width : int, optional
        Width of the images in place of the drawn one, in pixels.

    Returns
    -------
    DrawnScene
        To be given to `palletloc.synthetic.simulation.simulate` with its seed.
    """
    rng = np.random.default_rng([seed, _STREAM])
    full = seed % 2 == 0
    kind = _one_of(_CAMERAS, rng)
    models = _models(rng)
    side = list(Side)[rng.integers(len(Side))]
    mounting = _mounting(kind, side, rng)
    light = list(Illumination)[rng.integers(len(Illumination))]
    aisle = AisleSpec(
        models=models,
        side=side,
        levels=_levels(float(mounting.translation[2]), models[0].height, rng),
        distance=float(rng.uniform(1.2, 2.6)),
        filled=float(rng.uniform(0.5, 0.95)),
        yaw_sigma=float(np.radians(rng.uniform(0.3, 3.0))),
        setback_sigma=float(rng.uniform(0.0, 0.04)),
        loads=_LOADS[rng.choice(len(_LOADS), p=(0.7, 0.1, 0.1, 0.1))],
        light=light,
        occluders=int(rng.choice(4, p=(0.4, 0.2, 0.2, 0.2))),
        clutter=int(rng.integers(7)),
        lines=bool(rng.random() < 0.67),
        opposite=bool(rng.random() < 0.7),
        gloss=float(rng.uniform(0.1, 0.6)) if rng.random() < 0.5 else 0.0,
        misfit=float(rng.uniform(0.0, 1.5)),
    )
    translation_sigma, rotation_sigma = _mounting_sigmas(rng)
    spec = SimulationSpec(
        aisle=aisle,
        camera=kind,
        width=width or (FULL_WIDTH[kind] if full else FULL_WIDTH[kind] // 2),
        shots=shots,
        odometry=_odometry(float(rng.uniform(0.0, 1.5))),
        sensor=_sensor(light, rng),
        plane_offset=0.08,
        plane_turn=float(np.radians(1.5)),
        level_sigma=PriorConfig().level_sigma,
        mounting=mounting,
        mounting_translation_sigma=translation_sigma,
        mounting_rotation_sigma=rotation_sigma,
    )
    return DrawnScene(seed, full, spec)


def _one_of(shares: Mapping[_Kind, float], rng: np.random.Generator) -> _Kind:
    return list(shares)[rng.choice(len(shares), p=list(shares.values()))]


def _models(rng: np.random.Generator) -> tuple[PalletModel, ...]:
    library = load_library()
    others = [name for name in library if name not in _MODELS]
    count = 2 if rng.random() < _TWO_MODELS else 1
    names: list[str] = []
    while len(names) < count:
        name = _one_of(_MODELS, rng) or others[rng.integers(len(others))]
        if name not in names:
            names.append(name)
    return tuple(library[name] for name in names)


def _mounting(kind: CameraKind, side: Side, rng: np.random.Generator) -> RigidTransform:
    translation = rng.uniform([-0.3, -0.3, 1.3], [0.5, 0.3, 2.2])
    limits = (2.0, 6.0, 6.0) if rng.random() < 0.2 else (2.0, 2.0, 2.0)
    angles_deg = rng.uniform(-1, 1, 3) * limits
    if kind in (CameraKind.KANNALA_BRANDT, CameraKind.PINHOLE):
        sign = 1.0 if side is Side.LEFT else -1.0
        angles_deg += (sign * rng.uniform(45.0, 65.0), rng.uniform(8.0, 24.0), 0.0)
    return RigidTransform.from_components(translation, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def _mounting_sigmas(rng: np.random.Generator) -> tuple[float, float]:
    """Return the standard deviations of the mounting's place, in metres, and of its angles, in radians."""
    exact = rng.random() < 0.25
    place, turn = 10.0 ** rng.random(2) * (0.0003, 0.0002)
    return (0.0, 0.0) if exact else (float(place), float(turn))


def _levels(camera_height: float, pallet_height: float, rng: np.random.Generator) -> tuple[float, ...]:
    gap = float(rng.uniform(0.2, 0.4))
    near = camera_height + gap if rng.random() < 0.5 else camera_height - gap - pallet_height
    same = camera_height - float(rng.uniform(0.1, 0.9)) * pallet_height
    high = camera_height + float(rng.uniform(0.8, 1.2))
    with_same, with_high = rng.random(2) < (1 / 3, 1 / 7)
    return (0.0, near, *([same] if with_same else []), *([high] if with_high else []))


def _sensor(light: Illumination, rng: np.random.Generator) -> Sensor:
    exposure, fine = rng.random(), rng.random()
    if exposure < 0.2:
        least, most = (0.6, 1.0) if light is Illumination.DIM else (0.25, 0.6)
    elif exposure < 0.8:
        least, most = 0.75, 1.4
    else:
        least, most = 1.8, 3.0
    return Sensor(
        blur_px=float(rng.uniform(0.4, 1.5)),
        gain=float(least * (most / least) ** fine),
        noise=float(0.5 * 12.0 ** rng.random()),
        falloff=float(rng.uniform(0.0, 0.3)),
        jpeg_quality=int(rng.integers(80, 96)),
    )


def _odometry(factor: float) -> SimulatedOdometryNoise:
    usual = SimulatedOdometryNoise()
    return SimulatedOdometryNoise(
        factor * usual.scale_sigma,
        factor * usual.bias_sigma,
        factor * usual.speed_sigma,
        factor * usual.yaw_rate_sigma,
    )
