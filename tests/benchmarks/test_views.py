from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.scenes import FULL_WIDTH, draw_scene
from benchmarks.views import MOST_HIDDEN, Exposure, HeightClass, ShotViews, expose, height_class, look, recorded
from benchmarks.visibility import face_points, hidden_share
from palletloc import Candidate, Explanation, Fit, LevelPose, Localizer, PalletModel, Refusal, ShelfPlane, Shot
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.choices import CameraKind, Illumination, Side
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.pallet_library import load_library
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.rays import camera_rays
from palletloc.synthetic.rendering import lit, render
from palletloc.synthetic.rig import camera_of
from palletloc.synthetic.scene import Box, Light, Material, Room, Scene, Solid
from palletloc.synthetic.simulation import simulate

COVARIANCE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
AWAY = 9.0


class Told(Localizer):
    """A localizer that is told what to find."""

    outcomes: tuple[Fit | Refusal, ...] = ()

    def explain(self, shot: Shot, shelf: ShelfPlane) -> Explanation:
        assert shot is exposure().shot
        assert shelf.levels == exposure().recording.shelf.levels
        return Explanation(shot, (), (), self.outcomes)


@cache
def exposure() -> Exposure:
    scene = next(
        scene for seed in range(99) if (scene := draw_scene(seed, 1, 256)).spec.camera is CameraKind.EQUIRECTANGULAR
    )
    return expose(scene, simulate(scene.spec, scene.seed), 0)


def fit(pose: LevelPose, name: str) -> Fit:
    model = next(model for model in exposure().recording.models if model.name == name)
    return Fit(Candidate(model, pose), pose, COVARIANCE, YawSource.FACE)


def looked(outcomes: Sequence[Fit | Refusal]) -> ShotViews:
    localizer = Told(exposure().recording.models)
    localizer.outcomes = tuple(outcomes)
    return look(exposure(), localizer)


@pytest.mark.parametrize(
    ("below", "expected"),
    [
        (1.8, HeightClass.FLOOR),
        (0.6, HeightClass.FLOOR),
        (0.599, HeightClass.OTHER),  # its upper edge is 0.459 m below the camera
        (0.5, HeightClass.NEAR),
        (0.30, HeightClass.NEAR),
        (0.28, HeightClass.SAME),
        (0.07, HeightClass.SAME),
        (0.0, HeightClass.SAME),
        (-0.14, HeightClass.SAME),
        (-0.16, HeightClass.NEAR),
        (-0.46, HeightClass.OTHER),
    ],
)
def test_classes_go_by_the_edge_nearest_to_the_cameras_height(below: float, expected: HeightClass) -> None:
    assert height_class(below, 0.14) is expected


def test_a_perfect_localizer_has_no_error_and_one_counts_in_the_covariances_units() -> None:
    seen = looked([fit(face.forklift_from_pallet, face.model) for face in exposure().faces])
    assert len(seen.views) >= 2
    assert seen.false == ()
    for view in seen.views:
        assert view.error is not None
        assert not view.refused
        assert view.error.nees == pytest.approx(0.0, abs=1e-12)
    face = next(face for face in exposure().faces if face.visible)
    off = replace(face.forklift_from_pallet, x=face.forklift_from_pallet.x + 0.02)
    errors = [view.error for view in looked([fit(off, face.model)]).views if view.error]
    assert [error.nees for error in errors] == pytest.approx([4.0])


def test_refusals_misses_and_false_rows_differ_and_hidden_faces_do_not_count() -> None:
    face = next(face for face in exposure().faces if face.visible)
    found = fit(face.forklift_from_pallet, face.model)
    seen = looked([Refusal(found.candidate, Stage.VERIFICATION, Reason.LOW_CONTRAST, found)])
    assert all(view.error is None for view in seen.views)
    assert [view.face.id for view in seen.views if view.refused] == [face.id]
    model = exposure().recording.models[0].name
    assert looked([fit(LevelPose(AWAY, AWAY, 0.0, 0.0), model)]).false == (HeightClass.FLOOR,)
    shown = {view.face.id for view in looked([]).views}
    for face, hidden in zip(exposure().faces, exposure().hidden, strict=True):
        if hidden is None or hidden > MOST_HIDDEN:
            assert face.id not in shown


def test_the_recording_says_nothing_that_is_true_only() -> None:
    scene = next(scene for seed in range(99) if (scene := draw_scene(seed)).spec.mounting_rotation_sigma)
    simulation = simulate(scene.spec, scene.seed)
    recording = recorded(simulation)
    assert recording.forklift_from_camera is simulation.recorded_mounting
    assert recording.mounting.rotation_sigma == (scene.spec.mounting_rotation_sigma,) * 3
    assert recording.mounting.translation_sigma == (scene.spec.mounting_translation_sigma,) * 3
    assert recording.shelf.levels != tuple(sorted(scene.spec.aisle.levels))


# Scenes.

SCENES = [draw_scene(seed) for seed in range(300)]


def test_equal_seeds_draw_equal_scenes_and_others_vary_in_whatever_can() -> None:
    scene, same, other = draw_scene(7), draw_scene(7), draw_scene(9)
    assert scene.spec.aisle == same.spec.aisle
    assert scene.spec.sensor == same.spec.sensor
    assert simulate(scene.spec, 7).shelf == simulate(same.spec, 7).shelf
    assert scene.spec.sensor != other.spec.sensor
    assert scene.spec.aisle != other.spec.aisle
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


def test_every_second_scene_is_of_half_size_and_all_have_pallets_on_the_floor_and_near() -> None:
    for scene in SCENES[:20]:
        share = 1 if scene.full else 2
        assert scene.spec.width * share == FULL_WIDTH[scene.spec.camera]
    assert sum(scene.full for scene in SCENES) == len(SCENES) / 2
    assert draw_scene(3, width=320).spec.width == 320
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


# How much of a face is hidden.

EPAL, OPEN = (load_library()[name] for name in ("epal1-1200", "epal1-800"))
WHITE = Material((0.8, 0.8, 0.8))
ROOM = Room((-9.0, -9.0), (9.0, 9.0), 6.0, WHITE, WHITE, WHITE)
LIGHT = Light(((0.0, 0.0, 1.0),), (1.0,), sharp=1)
POSE = LevelPose(2.0, 0.0, 0.0, 0.0)
CAMERA = RigidTransform.from_translation([0.0, 0.0, 1.5])
WIDE = Equirectangular(960, 480)


def hidden(*before: Solid, camera: CameraModel = WIDE, yaw_deg: float = 0.0) -> float | None:
    """Share of a pallet 2 m ahead that is hidden, at the given heading of the camera."""
    world_from_camera = CAMERA * RigidTransform.from_rotation(Rotation.from_euler("z", yaw_deg, degrees=True))
    solids = (*before, PalletBody(POSE, EPAL, WHITE))
    picture = render(lit(Scene(ROOM, LIGHT, solids)), camera_rays(camera), world_from_camera, smooth=False)
    camera_from_pallet = world_from_camera.inv() * POSE.transform()
    return hidden_share(camera, picture.solids, len(before), camera_from_pallet, EPAL)


@pytest.mark.parametrize("model", [EPAL, OPEN], ids=lambda model: model.name)
def test_points_lie_on_the_solid_parts_of_the_face(model: PalletModel) -> None:
    x, y, z = face_points(model).T
    assert (x == 0.0).all()
    assert np.abs(y).max() < model.width / 2
    assert 0.0 < z.min() < z.max() < model.height
    for opening in model.openings:
        across = (-y > opening.left) & (-y < opening.right)
        assert not (across & (z > opening.bottom) & (z < opening.top)).any()
        assert (across & (z > opening.top)).any()


def test_what_stands_before_a_face_hides_it_and_nothing_else_does_even_at_the_seam() -> None:
    assert hidden() == 0.0
    assert hidden(Box(LevelPose(1.7, 0.0, 0.5, 0.0), (0.02, 3.0, 1.0), WHITE)) == 1.0
    assert hidden(Box(LevelPose(3.5, 0.0, 0.5, 0.0), (0.1, 3.0, 1.0), WHITE)) == 0.0
    assert hidden(yaw_deg=180.0) == 0.0


@pytest.mark.parametrize("side", [-1, 1])
def test_what_stands_before_one_half_hides_that_half(side: int) -> None:
    screen = Box(LevelPose(1.8, side * 0.45, 0.5, 0.0), (0.02, 0.9, 1.0), WHITE)
    assert hidden(screen) == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("kind", [CameraKind.PINHOLE, CameraKind.KANNALA_BRANDT])
def test_a_face_that_the_image_cuts_has_no_share(kind: CameraKind) -> None:
    camera = camera_of(kind, 320)
    assert hidden(camera=camera, yaw_deg=150.0) is None
    if kind is CameraKind.KANNALA_BRANDT:
        assert hidden(camera=camera) == 0.0
