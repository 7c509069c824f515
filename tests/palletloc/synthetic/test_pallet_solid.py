from dataclasses import replace

import numpy as np
import pytest

from palletloc import LevelPose, Opening, PalletModel, load_library
from palletloc.choices import Side
from palletloc.geometry import FloatArray
from palletloc.synthetic.aisle import Aisle, AisleSpec, StandingPallet, draw_aisle, misshapen
from palletloc.synthetic.loads import Load
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.placing import ShelfFrame
from palletloc.synthetic.samples import Samples
from palletloc.synthetic.scene import Box, Material

WOOD = Material((0.3, 0.4, 0.5))
HERE = LevelPose(0.0, 0.0, 0.0, 0.0)
LOPSIDED = PalletModel(
    "lopsided", 1.0, 0.15, 0.9, (Opening(-0.3, 0.02, 0.2, 0.1), Opening(0.15, 0.0, 0.4, 0.11)), 0.0, 0.004
)
LIBRARY = load_library()
FACES = [
    pytest.param([LIBRARY["epal1-1200"]], id="closed"),
    pytest.param([LIBRARY["epal1-800"]], id="open below"),
    pytest.param([LOPSIDED], id="lopsided"),
    pytest.param(list(LIBRARY.values()), id="library"),
]


def body(model: PalletModel) -> PalletBody:
    return PalletBody(HERE, model, WOOD)


def on_face(right: FloatArray, up: FloatArray) -> Samples:
    return np.stack([np.zeros(len(right)), -right, up]).astype(np.float32)


def in_front_face(model: PalletModel, right: FloatArray, up: FloatArray, gap: float) -> FloatArray:
    """1 well inside the drawn face, -1 well outside, 0 within a gap of its edges."""

    def depth(center: tuple[float, float], size: tuple[float, float]) -> FloatArray:
        return np.minimum(size[0] / 2 - np.abs(right - center[0]), size[1] / 2 - np.abs(up - center[1]))

    solid = depth((0.0, model.height / 2), (model.width, model.height))
    for o in model.openings:
        solid = np.minimum(solid, -depth((o.center, o.bottom + o.height / 2), (o.width, o.height)))
    return np.where(solid > gap, 1.0, np.where(solid < -gap, -1.0, 0.0))


@pytest.mark.parametrize("models", FACES)
def test_the_front_face_is_solid_exactly_where_it_is_drawn(models: list[PalletModel]) -> None:
    for model in models:
        rng = np.random.default_rng(1)
        right, up = rng.uniform(-0.6, 0.6, 4000) * model.width, rng.uniform(0.0, 1.1, 4000) * model.height
        drawn = in_front_face(model, right, up, gap=max(model.edge_radius, model.corner_radius, 1e-4))
        distance = body(model).distance(on_face(right, up))
        assert (np.abs(distance[drawn > 0]) < 1e-6).all()
        assert (distance[drawn < 0] > 1e-5).all()
        assert (drawn > 0).sum() > 500
        assert (drawn < 0).sum() > 500


@pytest.mark.parametrize("models", FACES)
def test_the_distance_never_exceeds_that_to_the_nearest_solid_point(models: list[PalletModel]) -> None:
    for model in models:
        pallet = body(model)
        rng = np.random.default_rng(2)
        low, high = pallet.low, pallet.high
        points = rng.uniform(low - 0.05, high + 0.05, (20000, 3)).T.astype(np.float32)
        distance = pallet.distance(points)
        inside, outside = points[:, distance < -1e-3], np.flatnonzero(distance > 0)[:300]
        apart = np.linalg.norm(points[:, outside, None] - inside[:, None, :], axis=0).min(axis=1)
        assert (distance[outside] <= apart + 1e-5).all()


def test_openings_go_through_the_pallet_and_normals_of_the_front_point_into_the_aisle(
    closed_below: PalletModel,
) -> None:
    x = np.linspace(0.0, closed_below.depth, 200).astype(np.float32)
    points = np.stack([x, np.full_like(x, -closed_below.openings[0].center), np.full_like(x, 0.07)])
    assert (body(closed_below).distance(points) > 0.01).all()
    front = np.array([[0.0], [0.0], [0.07]], np.float32)
    assert body(closed_below).normals(front)[:, 0] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-3)


def test_blocks_stand_where_the_model_has_them(closed_below: PalletModel) -> None:
    rows = ((0.0, 0.08), (0.3, 0.5))
    x = np.linspace(0.01, closed_below.depth - 0.01, 300).astype(np.float32)
    left, right = closed_below.blocks[1]
    points = np.stack([x, np.full_like(x, -(left + right) / 2), np.full_like(x, closed_below.openings[0].top - 0.03)])
    distance = body(replace(closed_below, block_rows=rows)).distance(points)
    within = [(x > front) & (x < back) for front, back in rows]
    np.testing.assert_array_equal(distance < 0, np.any(within, axis=0))


def test_boards_close_openings_from_below_only_where_drawn(
    closed_below: PalletModel, open_below: PalletModel
) -> None:
    for model, expected in ((closed_below, True), (open_below, False)):
        below = np.array([[0.02], [-model.openings[0].center], [0.011]], np.float32)
        assert (body(model).distance(below)[0] < 0) == expected


def test_the_rounding_of_an_edge_has_the_radius_of_the_model(t11: PalletModel) -> None:
    radius = t11.edge_radius
    angles = np.linspace(0.0, np.pi / 2, 50)
    x = radius - radius * np.sin(angles)
    up = t11.height - radius + radius * np.cos(angles)
    points = np.stack([x, np.zeros_like(x), up]).astype(np.float32)
    assert np.abs(body(t11).distance(points)).max() < 1e-6
    normals = body(t11).normals(points)
    expected = np.stack([-np.sin(angles), np.zeros_like(x), np.cos(angles)])
    assert np.abs(normals - expected).max() < 0.02


@pytest.mark.parametrize("models", FACES)
def test_the_blocks_that_cast_shadows_lie_in_the_body(models: list[PalletModel]) -> None:
    for model in models:
        pallet = PalletBody(LevelPose(1.0, 2.0, 0.5, 0.7), model, WOOD)
        rng = np.random.default_rng(3)
        margin = 1.5 * max(model.edge_radius, model.corner_radius)
        for block in pallet.blocks():
            half = block.high - margin
            if (half <= 0).any():
                continue
            local = rng.uniform(-half, half, (50, 3)).T
            turn, pose = block.world_from_solid.transform(), pallet.world_from_solid.transform()
            points = pose.inv().apply(turn.apply(local.T)).T.astype(np.float32)
            assert pallet.distance(points).max() < 0


def test_boards_differ_in_brightness_and_moulded_pallets_do_not(closed_below: PalletModel) -> None:
    right, up = np.full(100, -0.55), np.linspace(0.001, 0.143, 100)
    points = on_face(right, up)
    normals = np.zeros_like(points)
    normals[0] = -1.0
    assert len(np.unique(body(closed_below).tint(points, normals))) >= 4
    moulded = PalletBody(HERE, closed_below, WOOD, planks=False)
    assert np.unique(moulded.tint(points, normals)).tolist() == [1.0]


def test_a_box_of_which_nothing_is_flat_is_a_sphere() -> None:
    ball = Box(HERE, (0.2, 0.2, 0.2), WOOD, rounding=0.1)
    points = np.random.default_rng(4).normal(size=(3, 500)).astype(np.float32)
    assert ball.distance(points) == pytest.approx(np.linalg.norm(points, axis=0) - 0.1, abs=1e-5)
    surface = 0.1 * points / np.linalg.norm(points, axis=0)
    assert ball.normals(surface) == pytest.approx(10 * surface, abs=1e-3)


MODELS = tuple(load_library()[name] for name in ("epal1-1200", "t11-plastic", "epal1-800"))
SPEC = AisleSpec(models=MODELS, opposite=False, clutter=0, filled=0.9)


def draw(spec: AisleSpec, seed: int) -> Aisle:
    return draw_aisle(spec, np.random.default_rng(seed))


def footprint(pallet: StandingPallet) -> FloatArray:
    """The pallet's ground outline, sampled densely in the world."""
    x, y = np.meshgrid(np.linspace(0, pallet.model.depth, 23), np.linspace(-0.5, 0.5, 25) * pallet.model.width)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.05)], -1)
    return pallet.world_from_pallet.transform().apply(points)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("side", list(Side))
def test_pallets_stand_on_their_side_facing_the_path(seed: int, side: Side) -> None:
    aisle = draw(replace(SPEC, side=side), seed)
    sign = 1.0 if side is Side.LEFT else -1.0
    assert len(aisle.pallets) >= 4
    for pallet in aisle.pallets:
        pose = pallet.world_from_pallet
        assert abs(sign * pose.y - SPEC.distance) <= 2 * SPEC.setback_sigma + 1e-9
        assert abs(sign * pose.yaw - np.pi / 2) <= 3 * SPEC.yaw_sigma + 1e-9
        assert pose.z in SPEC.levels


@pytest.mark.parametrize("seed", range(4))
def test_no_pallet_stands_in_another_or_in_an_upright(seed: int) -> None:
    aisle = draw(replace(SPEC, loads=(Load.NONE,)), seed)
    bodies = [s for s in aisle.scene.solids if isinstance(s, PalletBody)]
    others = [s for s in aisle.scene.solids if not isinstance(s, PalletBody)]
    for pallet in aisle.pallets:
        points = footprint(pallet)
        for solid in [b for b in bodies if b.world_from_solid != pallet.world_from_pallet] + others:
            local = solid.world_from_solid.transform().inv().apply(points)
            inside = ((local > solid.low + 1e-6) & (local < solid.high - 1e-6)).all(axis=1)
            if solid.world_from_solid.z == pallet.world_from_pallet.z or solid in others:
                assert not inside.any()


def test_names_differ_bodies_have_the_true_poses_and_the_seed_draws_the_aisle() -> None:
    aisle = draw(SPEC, 1)
    assert len({p.name for p in aisle.pallets}) == len(aisle.pallets)
    bodies = [s for s in aisle.scene.solids if isinstance(s, PalletBody)]
    assert [b.world_from_solid for b in bodies] == [p.world_from_pallet for p in aisle.pallets]
    assert [b.model for b in bodies] == [p.model for p in aisle.pallets]
    assert draw(SPEC, 1) == aisle
    assert draw(SPEC, 6).pallets != aisle.pallets


def test_pallets_across_the_aisle_do_not_count() -> None:
    alone, both = draw(SPEC, 2), draw(replace(SPEC, opposite=True), 2)
    assert alone.pallets == both.pallets
    bodies = [s for s in both.scene.solids if isinstance(s, PalletBody)]
    across = [b for b in bodies if b.world_from_solid.y < 0]
    assert len(across) == len(bodies) - len(alone.pallets) > 0


def test_occluders_stand_before_a_front(closed_below: PalletModel) -> None:
    spec = replace(SPEC, models=(closed_below,), loads=(Load.NONE,))
    plain, hidden = draw(spec, 3), draw(replace(spec, occluders=2), 3)
    added = hidden.scene.solids[len(plain.scene.solids) :]
    assert len(added) >= 2
    assert all(s.world_from_solid.y < SPEC.distance for s in added)


def test_an_empty_rack_and_an_impossible_one() -> None:
    assert draw(replace(SPEC, filled=0.0), 0).pallets == ()
    for broken in (replace(SPEC, models=()), replace(SPEC, levels=())):
        with pytest.raises(ValueError, match="at least one"):
            draw(broken, 0)


def test_misfit_scales_with_the_tolerance(closed_below: PalletModel) -> None:
    assert misshapen(closed_below, 0.0, np.random.default_rng(0)) == closed_below
    rng = np.random.default_rng(0)
    widths = np.array([misshapen(closed_below, 0.5, rng).width for _ in range(2000)]) - closed_below.width
    assert widths.std() == pytest.approx(0.5 * closed_below.tolerance, rel=0.1)


def test_a_misfit_moves_blocks_inside_but_neither_those_of_the_face_nor_the_last(closed_below: PalletModel) -> None:
    rows = ((0.0, 0.1), (0.3, 0.4), (closed_below.depth - 0.1, closed_below.depth))
    rng = np.random.default_rng(0)
    shapes = [misshapen(replace(closed_below, block_rows=rows), 1.0, rng).block_rows for _ in range(400)]
    errors = np.array(shapes) - rows
    assert not errors[:, 0, 0].any()
    assert not errors[:, -1, -1].any()
    assert errors[:, 1].std() == pytest.approx(3 * closed_below.tolerance, rel=0.15)
    # and leaves all else as it is
    with_rows = replace(closed_below, block_rows=((0.0, 0.1), (0.3, 0.4)))
    plain, moved = (misshapen(model, 1.0, np.random.default_rng(4)) for model in (closed_below, with_rows))
    assert replace(moved, block_rows=()) == plain


def test_shape_errors_that_leave_no_pallet_are_drawn_again(closed_below: PalletModel) -> None:
    loose = replace(closed_below, tolerance=0.03)
    rng = np.random.default_rng(0)
    shapes = [misshapen(loose, 1.5, rng) for _ in range(50)]
    assert np.std([shape.width for shape in shapes]) > 0.03
    with pytest.raises(ValueError, match="misfit"):
        misshapen(loose, 1e4, rng)


@pytest.mark.parametrize("side", list(Side))
def test_the_shelf_frame_is_right_handed_and_runs_with_the_path(side: Side) -> None:
    frame = ShelfFrame(side, 2.0)
    deep, ahead = frame.world(0.5, 0.0, 0.0), frame.world(0.0, 3.0, 0.7)
    assert abs(deep.y) == pytest.approx(2.5)
    assert (ahead.x, ahead.z) == pytest.approx((3.0, 0.7))
