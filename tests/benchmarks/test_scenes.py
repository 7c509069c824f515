from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.scenes import FULL_WIDTH, draw_scene
from benchmarks.views import HeightClass, height_class
from palletloc.choices import CameraKind, Illumination, Side
from palletloc.synthetic.simulation import simulate

SCENES = [draw_scene(seed) for seed in range(300)]


def test_equal_seeds_draw_equal_scenes_and_others_draw_others() -> None:
    one, same, other = draw_scene(7), draw_scene(7), draw_scene(9)
    assert one.spec.aisle == same.spec.aisle
    assert one.spec.sensor == same.spec.sensor
    assert simulate(one.spec, 7).shelf == simulate(same.spec, 7).shelf
    assert one.spec.sensor != other.spec.sensor
    assert one.spec.aisle != other.spec.aisle


def test_whatever_can_vary_does() -> None:
    specs = [scene.spec for scene in SCENES]
    assert {spec.camera for spec in specs} == set(CameraKind)
    assert {spec.aisle.light for spec in specs} == set(Illumination)
    assert {spec.aisle.side for spec in specs} == set(Side)
    assert {len(spec.aisle.models) for spec in specs} == {1, 2}
    assert len({model.name for spec in specs for model in spec.aisle.models}) > 15
    assert Counter(spec.camera for spec in specs).most_common(1)[0][0] is CameraKind.EQUIRECTANGULAR


def test_parts_are_drawn_independently() -> None:
    drawn = np.array(
        [
            (
                scene.spec.sensor.blur_px,
                scene.spec.sensor.noise,
                scene.spec.aisle.misfit,
                scene.spec.aisle.distance,
                scene.spec.aisle.yaw_sigma,
                scene.full,
                scene.spec.aisle.side is Side.LEFT,
                scene.spec.mounting_rotation_sigma > 0,
            )
            for scene in SCENES
        ],
        dtype=np.float64,
    )
    correlation = np.corrcoef(drawn.T) - np.eye(drawn.shape[1])
    assert np.abs(correlation).max() < 4 / np.sqrt(len(SCENES))


def test_every_second_scene_has_images_of_half_size() -> None:
    for scene in SCENES[:20]:
        share = 1 if scene.full else 2
        assert scene.spec.width * share == FULL_WIDTH[scene.spec.camera]
    assert sum(scene.full for scene in SCENES) == len(SCENES) / 2
    assert draw_scene(3, width=320).spec.width == 320


def test_every_scene_has_pallets_on_the_floor_and_near_the_cameras_height() -> None:
    same = 0
    for scene in SCENES:
        mounting = scene.spec.mounting
        assert mounting is not None
        pallet = scene.spec.aisle.models[0].height
        classes = [height_class(mounting.translation[2] - level, pallet) for level in scene.spec.aisle.levels]
        assert classes[:2] == [HeightClass.FLOOR, HeightClass.NEAR]
        same += HeightClass.SAME in classes
    assert same == pytest.approx(len(SCENES) / 3, rel=0.3)


def test_what_the_recording_claims_is_how_far_it_is_off() -> None:
    places, turns, levels = [], [], []
    for scene in SCENES[::3]:
        empty = replace(scene.spec.aisle, filled=0.0, opposite=False, clutter=0)
        simulation = simulate(replace(scene.spec, aisle=empty), scene.seed)
        error = simulation.recorded_mounting * simulation.forklift_from_camera.inv()
        shift = simulation.recorded_mounting.translation - simulation.forklift_from_camera.translation
        sigmas = (scene.spec.mounting_translation_sigma, scene.spec.mounting_rotation_sigma)
        if all(sigmas):
            places.append(shift / sigmas[0])
            turns.append(error.rotation.as_rotvec() / sigmas[1])
        else:
            assert sigmas == (0.0, 0.0)
            assert np.abs(shift).max() == 0.0
            assert error.rotation.magnitude() < 1e-9
        levels.append(np.array(simulation.shelf.levels) - np.sort(scene.spec.aisle.levels))
    assert len(places) > 50
    assert np.mean(np.square(places)) == pytest.approx(1.0, abs=0.3)
    assert np.mean(np.square(turns)) == pytest.approx(1.0, abs=0.3)
    assert np.concatenate(levels).std() == pytest.approx(SCENES[0].spec.level_sigma, rel=0.2)
