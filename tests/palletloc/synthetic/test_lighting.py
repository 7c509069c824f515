from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palletloc.choices import Illumination
from palletloc.geometry import LevelPose
from palletloc.pallet import PalletModel
from palletloc.synthetic.lighting import light_field, light_of
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.scene import Box, Material

GREY = Material((0.5, 0.5, 0.5))
Scenes = Callable[[list[Any]], Any]


def at(*points: tuple[float, float]) -> tuple[Any, Any]:
    x, y = np.array(points, np.float32).T
    return x, y


def test_open_floor_has_the_light_of_every_direction(hall: Scenes) -> None:
    scene = hall([])
    assert light_field(scene).on_floor(*at((0.0, 0.0), (5.0, -3.0))) == pytest.approx(
        scene.light.open_ground, rel=1e-5
    )


def test_a_box_darkens_the_floor_beside_it_less_with_distance(hall: Scenes) -> None:
    field = light_field(hall([Box(LevelPose(0.0, 0.0, 0.5, 0.2), (1.0, 1.0, 1.0), GREY)]))
    near, nearer, far = field.on_floor(*at((0.75, 0.0), (0.6, 0.0), (4.0, 0.0)))
    assert nearer <= near < far
    assert far == pytest.approx(field.light.open_ground, rel=1e-3)


def test_the_shadow_of_a_slab_lies_where_its_edges_are_projected(hall: Scenes) -> None:
    scene = hall([Box(LevelPose(0.0, 0.0, 1.0, 0.0), (2.0, 2.0, 0.02), GREY)])
    x = np.linspace(-3.0, 3.0, 1201).astype(np.float32)
    floor = light_field(scene).on_floor(x, np.zeros_like(x))
    # light from (0.6, 0, 0.8) throws the edges at x = +-1, one metre up, to -1.75 and 0.25; from the other
    # side to -0.25 and 1.75; the two directions across reach all between -1 and 1
    full = scene.light.open_ground
    expected = full * (1 - 0.25 * (np.abs(x + 0.75) < 1) - 0.25 * (np.abs(x - 0.75) < 1) - 0.5 * (np.abs(x) < 1))
    assert np.mean(np.abs(floor - expected) > 0.02 * full) < 0.05


def test_the_inside_of_an_opening_is_darker_than_the_face(closed_below: PalletModel, hall: Scenes) -> None:
    pallet = PalletBody(LevelPose(0.0, 0.0, 0.0, 0.0), closed_below, GREY)
    field = light_field(hall([pallet]))
    front = np.array([[0.0], [0.0], [0.07]], np.float32), np.array([[-1.0], [0.0], [0.0]], np.float32)
    inner = np.array([[0.4], [-0.264], [0.001]], np.float32), np.array([[0.0], [0.0], [1.0]], np.float32)
    assert field.irradiance(*inner)[0] < 0.5 * field.irradiance(*front)[0]


@pytest.mark.parametrize("kind", list(Illumination))
def test_every_kind_of_light_gives_open_ground_the_light_that_it_says(kind: Illumination) -> None:
    light = light_of(kind, np.random.default_rng(5))
    assert light.open_ground == pytest.approx(1.0)
    assert np.linalg.norm(light.directions, axis=1) == pytest.approx(1.0)
    assert all(z > 0 for _, _, z in light.directions)
    assert (light.colour[1] < 0.5) == (kind is Illumination.DIM)
