from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from palletloc.face import face_edges
from palletloc.geometry import FloatArray
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.refinement.samples import LEVEL_SPACING, face_samples


def distances(points: FloatArray, model: PalletModel, horizontal: bool) -> FloatArray:
    """The distance of each point from each edge of a direction, (points, edges)."""
    edges = [edge for edge in face_edges(model) if edge.horizontal is horizontal]
    starts, ends = np.array([edge.start for edge in edges]), np.array([edge.end for edge in edges])
    nearest = np.clip(points[:, None], starts, ends)  # edges run along the axes
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def test_the_weights_of_all_edges_add_up_to_one(model: PalletModel) -> None:
    samples = face_samples(model)
    assert samples.level_weight.sum() + samples.upright_weight.sum() == pytest.approx(1.0)
    assert samples.level_weight.min() > 0
    assert samples.upright_weight.min() > 0
    for points, weight in (
        (samples.level, samples.level_weight),
        (samples.upright, samples.upright_weight),
        (samples.block, samples.block_weight),
    ):
        assert points.shape == (len(weight), 2)


def test_every_point_lies_on_an_edge_and_every_edge_has_points(model: PalletModel) -> None:
    samples = face_samples(model)
    for horizontal, points in ((True, samples.level), (False, samples.upright)):
        away = distances(points, model, horizontal)
        assert away.min(axis=1).max() < 1e-12
        assert away.min(axis=0).max() < 1e-12


def test_points_are_dense_enough_for_no_stretch_to_be_missed(model: PalletModel) -> None:
    level = face_samples(model).level
    for edge in face_edges(model):
        if edge.horizontal:
            mine = level[np.isclose(level[:, 1], edge.start[1])]
            mine = mine[(mine[:, 0] > edge.start[0]) & (mine[:, 0] < edge.end[0])]
            gaps = np.diff([edge.start[0], *np.sort(mine[:, 0]), edge.end[0]])
            assert gaps.max() < 1.6 * LEVEL_SPACING


def test_on_each_kind_of_edge_weight_is_spread_by_length(model: PalletModel) -> None:
    samples = face_samples(model)
    for horizontal, points, weight in (
        (True, samples.level, samples.level_weight),
        (False, samples.upright, samples.upright_weight),
    ):
        edges = [edge for edge in face_edges(model) if edge.horizontal is horizontal]
        owner = distances(points, model, horizontal).argmin(axis=1)
        share = np.bincount(owner, weight, len(edges)) / np.array([edge.length for edge in edges])
        np.testing.assert_allclose(share, share[0], rtol=1e-9)


def test_points_in_blocks_lie_in_the_solid_well_off_its_edges_and_count_against_a_pose(model: PalletModel) -> None:
    samples = face_samples(model)
    assert len(samples.block) > 0 or max(right - left for left, right in model.blocks) < 0.04
    assert (samples.block_weight < 0).all()
    assert samples.block_weight.sum() > -1.0
    for right, up in samples.block:
        assert abs(right) < model.width / 2
        assert 0.0 < up < model.height
        assert not any(o.left <= right <= o.right and o.bottom <= up <= o.top for o in model.openings)
    for horizontal in (True, False):
        assert distances(samples.block, model, horizontal).min(initial=1.0) > 0.01


def test_every_block_is_looked_at(model: PalletModel) -> None:
    block = face_samples(model).block[:, 0]
    for left, right in model.blocks:
        if len(block) and right - left > 0.05:
            assert ((block > left) & (block < right)).any()


@pytest.mark.parametrize(
    "law",
    [
        test_the_weights_of_all_edges_add_up_to_one,
        test_every_point_lies_on_an_edge_and_every_edge_has_points,
        test_points_are_dense_enough_for_no_stretch_to_be_missed,
        test_on_each_kind_of_edge_weight_is_spread_by_length,
        test_points_in_blocks_lie_in_the_solid_well_off_its_edges_and_count_against_a_pose,
        test_every_block_is_looked_at,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_what_is_shared_cannot_be_written(t11: PalletModel) -> None:
    samples = face_samples(t11)
    assert face_samples(t11) is samples
    for array in (samples.level, samples.upright, samples.block, samples.level_weight, samples.block_weight):
        assert not array.flags.writeable
