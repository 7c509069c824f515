"""A rack that holds cartons and no pallet: whatever is tried there must find nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from palletloc.choices import CameraKind, Illumination, Side
from palletloc.geometry import LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
from palletloc.synthetic.aisle import AisleSpec, draw_aisle
from palletloc.synthetic.loads import stack
from palletloc.synthetic.placing import ShelfFrame
from palletloc.synthetic.rays import CameraRays, camera_rays
from palletloc.synthetic.rendering import lit, render
from palletloc.synthetic.rig import Sensor, camera_of, draw_mounting, expose
from palletloc.synthetic.scene import Solid

Models = tuple[PalletModel, ...]
Empty = tuple[Shot, ShelfPlane, ShelfFrame]
Empties = Callable[[int], Empty]
Faults = Callable[..., list[str]]
Makes = Callable[..., Localizer]

FEW = settings(max_examples=settings().max_examples * 6 // 100, phases=[Phase.generate])
LEVELS = (0.0, 1.4)
CAMERAS = ((CameraKind.PINHOLE, 640), (CameraKind.KANNALA_BRANDT, 800), (CameraKind.EQUIRECTANGULAR, 1280))
BEGIN, END = -0.5, 3.5
"""Along the aisle, in metres."""

seeds = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 18))]
offsets = st.tuples(st.floats(-0.3, 0.8), st.floats(np.radians(-20.0), np.radians(20.0)))


def cartons(frame: ShelfFrame, rng: np.random.Generator) -> list[Solid]:
    """Return stacks of cartons on every level, some with gaps as wide as an opening."""
    solids: list[Solid] = []
    for level in LEVELS:
        along = BEGIN
        while along < END:
            width, gap = rng.uniform([0.3, 0.03], [1.2, 0.45]).tolist()
            foot = frame.world(float(rng.uniform(-0.02, 0.1)), along + width / 2, level, float(rng.normal(0.0, 0.02)))
            height = float(rng.uniform(0.12, 0.6))
            solids += stack(foot, (0.0, -width / 2, 0.0), (0.5, width / 2, height), rng)
            along += width + gap
    return solids


@pytest.fixture(scope="session")
def models(epal: PalletModel, t11: PalletModel, open_below: PalletModel) -> Models:
    """Return all that is looked for."""
    return (epal, t11, open_below)


@pytest.fixture(scope="session")
def empty_shelf(models: Models) -> Empties:
    """Return a function that draws a rack without pallets, each once, and takes its picture."""
    kept: dict[int, Empty] = {}
    rays: dict[tuple[CameraKind, int], CameraRays] = {}

    def drawn(seed: int) -> Empty:
        if seed not in kept:
            rng = np.random.default_rng(seed)
            kind = CAMERAS[seed % len(CAMERAS)]
            side = (Side.LEFT, Side.RIGHT)[seed // 2 % 2]
            light = tuple(Illumination)[seed % len(Illumination)]
            spec = AisleSpec(
                models, side, LEVELS, 1.9, BEGIN, END - BEGIN, filled=0.0, light=light, opposite=False, clutter=1
            )
            aisle = draw_aisle(spec, rng)
            things = cartons(aisle.frame, rng) if seed % 3 else []
            scene = lit(replace(aisle.scene, solids=(*aisle.scene.solids, *things)))
            mounting = draw_mounting(kind[0], side, rng)
            rays.setdefault(kind, camera_rays(camera_of(*kind)))
            camera = rays[kind].camera
            picture = render(scene, rays[kind], mounting)
            image = expose(picture.radiance, Sensor(), camera.period_px is not None, rng)
            shot = Shot(image, camera, Mounting(mounting))
            front = aisle.frame.world(0.0, 1.0, 0.0)
            kept[seed] = shot, ShelfPlane(front.x, front.y, front.yaw + np.pi, LEVELS), aisle.frame
        return kept[seed]

    return drawn


@pytest.mark.parametrize("seed", seeds)
@pytest.mark.parametrize(
    "known",
    [
        True,
        pytest.param(False, marks=pytest.mark.slow),
    ],
    ids=["level", "free"],
)
def test_nothing_is_found_on_an_empty_shelf(
    seed: int, known: bool, empty_shelf: Empties, models: Models, localizer: Makes, faults: Faults
) -> None:
    shot, shelf, _ = empty_shelf(seed)
    found = localizer([(model, None) for model in models])
    explained = found.explain(shot, shelf if known else replace(shelf, levels=()))
    assert explained.outcomes
    assert faults(explained) == []


def from_everywhere(
    seed: int, offset: tuple[float, float], known: bool, empty: Empties, models: Models, localizer: Makes
) -> list[str]:
    """Return what is found from starts along the whole shelf, moved along their viewing rays and turned."""
    shot, _, frame = empty(seed)
    farther, turn = offset
    starts, center = [], shot.mounting.center
    for number, along in enumerate(np.arange(BEGIN, END, 0.37).tolist()):
        pose = frame.world(0.0, along, LEVELS[number % 2])
        ray = np.array([pose.x, pose.y]) - center[:2]
        x, y = center[:2] + ray * (1 + farther / np.linalg.norm(ray))
        start = LevelPose(float(x), float(y), pose.z, pose.yaw + turn)
        starts.append(Start(models[number % len(models)].name, start))
    found = localizer([(model, None) for model in models])
    explained = found.explain_from(shot, starts, LEVELS if known else ())
    assert len(explained.measurements) + len(explained.refusals) == len(starts)
    return [f"{one.model} at {one.forklift_from_pallet}, score {one.score:.2f}" for one in explained.measurements]


@FEW
@given(seed=st.integers(0, 1), offset=offsets)
def test_starts_far_off_on_an_empty_shelf_find_nothing(
    empty_shelf: Empties, models: Models, localizer: Makes, seed: int, offset: tuple[float, float]
) -> None:
    assert from_everywhere(seed, offset, True, empty_shelf, models, localizer) == []


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False], ids=["level", "free"])
def test_hardly_a_start_on_an_empty_shelf_finds_anything(
    known: bool, empty_shelf: Empties, models: Models, localizer: Makes
) -> None:
    # cartons with a gap as wide as an opening, over a beam's shadow, do look like a pallet
    rng, found, tried = np.random.default_rng(5), [], 0
    for seed in range(18):
        offset = float(rng.uniform(-0.3, 0.8)), float(np.radians(rng.uniform(-20.0, 20.0)))
        found += from_everywhere(seed, offset, known, empty_shelf, models, localizer)
        tried += len(np.arange(BEGIN, END, 0.37))
    assert tried > 150
    assert len(found) <= 0.01 * tried, found
