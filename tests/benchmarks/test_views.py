from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.scenes import draw_scene
from benchmarks.views import MOST_HIDDEN, Exposure, HeightClass, ShotViews, expose, height_class, look, recorded
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.choices import CameraKind
from palletloc.geometry import LevelPose
from palletloc.localizer import Explanation, Localizer
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
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


def test_a_perfect_localizer_finds_every_pallet_without_an_error() -> None:
    seen = looked([fit(face.forklift_from_pallet, face.model) for face in exposure().faces])
    assert len(seen.views) >= 2
    assert seen.false == ()
    for view in seen.views:
        assert view.error is not None
        assert not view.refused
        assert view.error.nees == pytest.approx(0.0, abs=1e-12)


def test_an_error_counts_in_the_covariances_units() -> None:
    face = next(face for face in exposure().faces if face.visible)
    off = replace(face.forklift_from_pallet, x=face.forklift_from_pallet.x + 0.02)
    errors = [view.error for view in looked([fit(off, face.model)]).views if view.error]
    assert [error.nees for error in errors] == pytest.approx([4.0])


def test_refusals_and_misses_differ() -> None:
    face = next(face for face in exposure().faces if face.visible)
    found = fit(face.forklift_from_pallet, face.model)
    seen = looked([Refusal(found.candidate, Stage.VERIFICATION, Reason.LOW_CONTRAST, found)])
    assert all(view.error is None for view in seen.views)
    assert [view.face.id for view in seen.views if view.refused] == [face.id]


def test_a_row_where_no_pallet_stands_is_false_at_its_height() -> None:
    model = exposure().recording.models[0].name
    assert looked([fit(LevelPose(AWAY, AWAY, 0.0, 0.0), model)]).false == (HeightClass.FLOOR,)


def test_faces_that_are_mostly_hidden_or_cut_do_not_count() -> None:
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
