from dataclasses import replace

import numpy as np
import pytest

from palletloc.choices import Side
from palletloc.geometry import FloatArray
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.synthetic.aisle import Aisle, AisleSpec, StandingPallet, draw_aisle, misshapen
from palletloc.synthetic.loads import Load
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.placing import ShelfFrame

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


def test_names_are_different_and_bodies_have_the_true_poses() -> None:
    aisle = draw(SPEC, 1)
    assert len({p.name for p in aisle.pallets}) == len(aisle.pallets)
    bodies = [s for s in aisle.scene.solids if isinstance(s, PalletBody)]
    assert [b.world_from_solid for b in bodies] == [p.world_from_pallet for p in aisle.pallets]
    assert [b.model for b in bodies] == [p.model for p in aisle.pallets]


def test_the_same_seed_draws_the_same_aisle_and_another_one_another() -> None:
    assert draw(SPEC, 5) == draw(SPEC, 5)
    assert draw(SPEC, 5).pallets != draw(SPEC, 6).pallets


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


def test_a_misfit_of_the_blocks_inside_leaves_all_else_as_it_is(closed_below: PalletModel) -> None:
    with_rows = replace(closed_below, block_rows=((0.0, 0.1), (0.3, 0.4)))
    shapes = [misshapen(model, 1.0, np.random.default_rng(4)) for model in (closed_below, with_rows)]
    assert replace(shapes[1], block_rows=()) == shapes[0]


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
