"""Given starts that are no poses, or lie where nothing can be seen, or another pallet or none stands."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc import Explanation, LevelPose, Localizer, Method, Mounting, ShelfPlane, Shot, Start
from palletloc.choices import CameraKind, Illumination, Side
from palletloc.measurement import Reason, Stage
from palletloc.methods import METHODS
from palletloc.synthetic.aisle import AisleSpec, draw_aisle
from palletloc.synthetic.loads import stack
from palletloc.synthetic.placing import ShelfFrame
from palletloc.synthetic.rays import CameraRays, camera_rays
from palletloc.synthetic.rendering import lit, render
from palletloc.synthetic.rig import Sensor, camera_of, draw_mounting, expose
from palletloc.synthetic.scene import Solid
from tests.palletloc.bad_input.drawn import HEIGHTS, NAMES, Check, Faults, Scenes, few
from tests.palletloc.poses import Makes, Models, slid

Moves = tuple[float, float, float, float]

FEW = few(6)
SOME = few(12)
both = pytest.mark.parametrize("known", [True, False], ids=["level", "free"])

names = st.sampled_from(NAMES)
broken = st.sampled_from([np.nan, np.inf, -np.inf])
fields = st.sampled_from(["x", "y", "z", "yaw"])
huge = st.sampled_from([1e7, -1e7, 1e160, -1e160, 1e308, -1e308])
turns = st.floats(-np.radians(20.0), np.radians(20.0))
along_ray = st.floats(-0.3, 0.8)
moves = st.tuples(st.floats(-0.18, 0.18), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), turns)
"""Of a start: less aside than half an opening."""
anywhere = st.builds(
    LevelPose, st.floats(-7.0, 7.0), st.floats(-7.0, 7.0), st.floats(-3.0, 5.0), st.floats(-np.pi, np.pi)
)


def far_off(shot: Shot, pose: LevelPose, farther: float, turn: float) -> LevelPose:
    """Return a pose that is moved along its viewing ray, at its own height, and turned."""
    away = float(np.hypot(*(np.array([pose.x, pose.y]) - shot.mounting.center[:2])))
    return replace(slid(shot, pose, 1 + farther / away), z=pose.z, yaw=pose.yaw + turn)


@pytest.fixture(scope="session")
def started(scenes: Scenes, localizer: Makes, faults: Faults) -> Check:
    """Return a function that measures from starts in a scene and checks the rows."""

    def checked(name: str, starts: Sequence[Start], known: bool = True) -> Explanation:
        shot, pallets, shelf = scenes(name)
        levels = shelf.levels if known else ()
        explained = localizer(pallets).explain_from(shot, starts, levels)
        assert [outcome.candidate.model.name for outcome in explained.outcomes] == [start.model for start in starts]
        assert faults(explained, pallets) == []
        return explained

    return checked


@pytest.mark.parametrize("every", METHODS, ids=str)
@SOME
@given(name=st.sampled_from(["floor", "pinhole"]), changed=st.dictionaries(fields, broken, min_size=1))
def test_a_start_that_is_not_finite_is_refused_as_such(
    every: Method, scenes: Scenes, name: str, changed: dict[str, float]
) -> None:
    shot, pallets, _ = scenes(name)
    model, pose = pallets[0]
    found = Localizer([model], every)
    explained = found.explain_from(shot, [Start(model.name, replace(pose, **changed))], (0.0,))
    assert explained.measurements == []
    assert [(refusal.stage, refusal.reason) for refusal in explained.refusals] == [(Stage.START, Reason.NOT_FINITE)]


@pytest.mark.parametrize("every", METHODS, ids=str)
@SOME
@given(name=st.sampled_from(["floor", "pinhole"]), field=st.sampled_from(["x", "y", "z"]), value=huge)
def test_a_start_that_is_no_place_is_refused_before_any_step(
    every: Method, scenes: Scenes, name: str, field: str, value: float
) -> None:
    shot, pallets, _ = scenes(name)
    model, pose = pallets[0]
    found = Localizer([model], every)
    explained = found.explain_from(shot, [Start(model.name, replace(pose, **{field: value}))], (0.0,))
    assert explained.measurements == []
    assert [refusal.stage for refusal in explained.refusals] == [Stage.START]


@pytest.mark.parametrize("every", METHODS, ids=str)
@pytest.mark.parametrize(
    ("name", "moved", "reasons"),
    [
        ("pinhole", {"y": 1.9, "yaw": np.pi / 2}, {Reason.OUT_OF_VIEW}),
        ("pinhole", {"x": -2.5}, {Reason.OUT_OF_VIEW}),
        ("pinhole", {"z": 4.5}, {Reason.OUT_OF_VIEW}),
        ("pinhole", {"z": -4.0}, {Reason.OUT_OF_VIEW}),
        ("fisheye", {"x": -1.5, "y": 1.6, "yaw": np.pi / 2}, {Reason.OUT_OF_VIEW}),
        ("floor", {"yaw": -np.pi / 2}, {Reason.BEHIND_FACE}),
        ("floor", {"y": -2.0}, {Reason.BEHIND_FACE}),
        ("floor", {"x": 0.3, "y": 0.0, "yaw": np.pi / 2}, {Reason.BEHIND_FACE}),
        ("floor", {"y": 60.0}, {Reason.OUT_OF_RANGE}),
        ("floor", {"x": -1e200}, {Reason.OUT_OF_RANGE}),
        ("floor", {"z": 40.0}, {Reason.OUT_OF_RANGE}),
        ("floor", {"z": -40.0}, {Reason.OUT_OF_RANGE}),
        ("floor", {"x": 40.0}, {Reason.OUT_OF_RANGE}),
    ],
    ids=str,
)
def test_a_start_that_the_camera_cannot_see_is_refused_with_its_reason(
    every: Method, name: str, moved: dict[str, float], reasons: set[Reason], scenes: Scenes
) -> None:
    shot, pallets, _ = scenes(name)
    model, pose = pallets[0]
    found = Localizer([model], every)
    explained = found.explain_from(shot, [Start(model.name, replace(pose, **moved))])
    assert explained.measurements == []
    assert {refusal.reason for refusal in explained.refusals} <= reasons
    assert {refusal.stage for refusal in explained.refusals} == {Stage.START}
    assert [outcome.fit for outcome in explained.outcomes] == [None]


def test_levels_that_are_not_finite_are_no_levels(scenes: Scenes, localizer: Makes) -> None:
    shot, pallets, _ = scenes("pinhole")
    model, pose = pallets[0]
    found = localizer(pallets).explain_from(shot, [Start(model.name, pose)], (np.nan, np.inf, -np.inf))
    assert [outcome.candidate.height for outcome in found.outcomes] == [None]


@HEIGHTS
@FEW
@given(name=names, poses=st.lists(anywhere, min_size=1, max_size=4), which=st.integers(0, 1))
def test_starts_anywhere_give_no_wrong_row(
    started: Check, scenes: Scenes, name: str, poses: list[LevelPose], which: int, known: bool
) -> None:
    started(name, [Start(scenes(name)[1][which][0].name, pose) for pose in poses], known)


@HEIGHTS
@FEW
@given(name=names, which=st.integers(0, 1), farther=along_ray, turn=turns)
def test_no_start_far_off_gives_a_wrong_row(
    started: Check, scenes: Scenes, name: str, which: int, farther: float, turn: float, known: bool
) -> None:
    shot, pallets, _ = scenes(name)
    model, pose = pallets[which]
    started(name, [Start(model.name, far_off(shot, pose, farther, turn))], known)


@FEW
@given(name=st.sampled_from(["floor", "fisheye", "pinhole"]), which=st.integers(0, 1), turn=turns)
def test_a_start_of_another_model_than_stands_there_gives_no_wrong_row(
    started: Check, scenes: Scenes, name: str, which: int, turn: float
) -> None:
    _, pallets, _ = scenes(name)
    pose = replace(pallets[which][1], yaw=pallets[which][1].yaw + turn)
    started(name, [Start(pallets[1 - which][0].name, pose)])


@pytest.mark.parametrize("name", ["floor", "fisheye", "pinhole"])
@both
def test_another_model_is_never_found(name: str, known: bool, started: Check, scenes: Scenes) -> None:
    _, pallets, _ = scenes(name)
    starts = [
        Start(model.name, replace(pose, x=pose.x + shift))
        for model, _ in pallets
        for other, pose in pallets
        for shift in (-0.05, 0.0, 0.05)
        if other is not model
    ]
    assert started(name, starts, known).measurements == []


@FEW
@given(name=names, which=st.integers(0, 1), farther=st.floats(-0.1, 0.1), turn=st.floats(-0.1, 0.1))
def test_two_starts_on_one_pallet_lead_to_one_pose(
    started: Check, scenes: Scenes, name: str, which: int, farther: float, turn: float
) -> None:
    shot, pallets, _ = scenes(name)
    model, pose = pallets[which]
    rows = started(name, [Start(model.name, p) for p in (pose, far_off(shot, pose, farther, turn))]).measurements
    if len(rows) == 2:
        first, second = (row.forklift_from_pallet.as_array() for row in rows)
        assert np.abs(first - second)[:3].max() < 0.06


@HEIGHTS
@FEW
@given(name=names, moves=st.tuples(moves, moves, moves))
def test_no_start_around_a_pallet_gives_a_wrong_row(
    started: Check, scenes: Scenes, name: str, moves: tuple[Moves, ...], known: bool
) -> None:
    starts = [
        Start(model.name, LevelPose(*(pose.as_array() + move).tolist()))
        for (model, pose), move in zip(scenes(name)[1], moves, strict=False)
    ]
    started(name, starts, known)


@pytest.mark.parametrize("method", [Method.REFINED], ids=str, indirect=True)
def test_a_start_farther_aside_than_an_opening_gives_no_wrong_row(scenes: Scenes, started: Check) -> None:
    model, pose = scenes("rack")[1][2]
    move = np.array([-0.705303716973279, -0.43117586641955463, -0.23272903984143478, 0.2225154874505622])
    started("rack", [Start(model.name, LevelPose(*(pose.as_array() + move).tolist()))])


# A rack that holds cartons and no pallet: whatever is tried there must find nothing.

Empty = tuple[Shot, ShelfPlane, ShelfFrame]
Empties = Callable[[int], Empty]

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
@pytest.mark.parametrize("known", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["level", "free"])
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
    return [f"{row.model} at {row.forklift_from_pallet}, score {row.score:.2f}" for row in explained.measurements]


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
