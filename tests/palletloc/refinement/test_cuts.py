from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest

from palletloc.face import face_lines
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.refinement.profiles import FEWEST_CUTS, MOST_CUTS, FaceCuts, face_cuts

LEVEL, UPRIGHT = 0.006, 0.005


def cuts_of(model: PalletModel, without_bottom: bool = False) -> FaceCuts:
    return face_cuts(model, LEVEL, UPRIGHT, without_bottom)


def test_every_stretch_of_every_line_is_covered_evenly_from_end_to_end(model: PalletModel) -> None:
    cuts = cuts_of(model)
    assert set(cuts.lines) == set(face_lines(model))
    assert len(cuts.lines) == len(face_lines(model))
    assert (np.diff(cuts.level.astype(int)) <= 0).all()
    ranges = [np.arange(len(cuts.line))[kind.cuts] for kind in cuts.kinds]
    np.testing.assert_array_equal(np.concatenate(ranges), np.arange(len(cuts.line)))
    for kind, there in zip(cuts.kinds, ranges, strict=True):
        assert set(cuts.line[there]) == set(np.arange(len(cuts.lines))[kind.lines])
        assert len(set(cuts.level[kind.lines])) == 1
    counted = 0
    for number, line in enumerate(cuts.lines):
        inner = cuts.inner[cuts.line[cuts.inner] == number]
        spacing = LEVEL if line.whole.horizontal else UPRIGHT
        for edge in line.edges:
            start, end = np.array(edge.start), np.array(edge.end)
            way = (end - start) / edge.length
            along = (cuts.points[inner] - start) @ way
            mine = inner[(along > -1e-9) & (along < edge.length + 1e-9)]
            place = (cuts.points[mine] - start) @ way
            np.testing.assert_allclose(cuts.points[mine], start + place[:, None] * way, atol=1e-12)
            apart = edge.length / len(mine)
            np.testing.assert_allclose(np.diff(place), apart, atol=1e-12)
            assert place[0] == pytest.approx(apart / 2)
            assert edge.length - place[-1] == pytest.approx(apart / 2)
            assert len(mine) in (FEWEST_CUTS, MOST_CUTS) or apart == pytest.approx(spacing, abs=0.5 * apart / 7)
            np.testing.assert_allclose(cuts.end[mine], np.minimum(place, edge.length - place), atol=1e-12)
            counted += len(mine)
    assert counted == len(cuts.inner)


def test_positions_count_from_the_middle_of_the_whole_line(model: PalletModel) -> None:
    cuts = cuts_of(model)
    for number, line in enumerate(cuts.lines):
        mine = cuts.line == number
        way = np.array([1.0, 0.0] if line.whole.horizontal else [0.0, 1.0])
        expected = (cuts.points[mine] - np.array(line.whole.middle)) @ way
        np.testing.assert_allclose(cuts.along[mine], expected, atol=1e-12)
        assert cuts.level[number] == line.whole.horizontal
        np.testing.assert_array_equal(cuts.outward[mine], np.tile(line.whole.outward, (mine.sum(), 1)))


def test_pads_never_count(model: PalletModel) -> None:
    cuts = cuts_of(model)
    pads = np.setdiff1d(np.arange(len(cuts.line)), cuts.inner)
    assert len(pads) > 0
    assert (cuts.end[pads] < 0).all()
    assert (cuts.end[cuts.inner] > 0).all()
    values = np.full(len(cuts.line), np.inf)
    values[cuts.inner] = np.arange(len(cuts.inner))
    table = cuts.by_line(values, -1.0)
    assert table.shape == (len(cuts.lines), cuts.count)
    assert np.isfinite(table).all()
    np.testing.assert_array_equal(np.sort(table[table >= 0]), np.arange(len(cuts.inner)))


def test_each_row_of_a_table_is_a_line_in_order_and_filled_up_at_its_end(model: PalletModel) -> None:
    cuts = cuts_of(model)
    along = cuts.by_line(cuts.along, np.nan)
    np.testing.assert_array_equal(cuts.in_line, np.nan_to_num(along))
    for number, row in enumerate(along):
        there = row[np.isfinite(row)]
        assert len(there) == (cuts.line[cuts.inner] == number).sum()
        assert np.isfinite(row[: len(there)]).all()
        assert (np.diff(there) > 0).all()
    assert np.isfinite(along).all(axis=1).any()


def test_the_spacing_of_a_kind_is_the_mean_of_length_over_cuts_of_its_lines(model: PalletModel) -> None:
    cuts = cuts_of(model)
    counts = np.bincount(cuts.line[cuts.inner])
    spacing = np.array([sum(edge.length for edge in line.edges) for line in cuts.lines]) / counts
    for kind in cuts.kinds:
        assert kind.spacing == pytest.approx(spacing[kind.lines].mean())


def test_without_the_lower_edge_all_else_stays(model: PalletModel) -> None:
    whole, above = cuts_of(model), cuts_of(model, without_bottom=True)
    assert above.lines == tuple(line for line in whole.lines if line.kind != "bottom")
    kept = np.array([line.kind != "bottom" for line in whole.lines])[whole.line]
    np.testing.assert_array_equal(above.points, whole.points[kept])


@pytest.mark.parametrize(
    "law",
    [
        test_every_stretch_of_every_line_is_covered_evenly_from_end_to_end,
        test_positions_count_from_the_middle_of_the_whole_line,
        test_pads_never_count,
        test_each_row_of_a_table_is_a_line_in_order_and_filled_up_at_its_end,
        test_the_spacing_of_a_kind_is_the_mean_of_length_over_cuts_of_its_lines,
        test_without_the_lower_edge_all_else_stays,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_what_is_shared_cannot_be_written(t11: PalletModel) -> None:
    cuts = cuts_of(t11)
    assert cuts_of(t11) is cuts
    arrays = [getattr(cuts, one.name) for one in fields(cuts) if isinstance(getattr(cuts, one.name), np.ndarray)]
    assert not any(array.flags.writeable for array in arrays)


def test_another_model_has_other_cuts_even_under_the_same_name(t11: PalletModel, epal: PalletModel) -> None:
    wider = replace(t11, width=t11.width + 0.004)
    for other in (wider, epal):
        here, there = cuts_of(t11), cuts_of(other)
        assert here.points.shape != there.points.shape or not np.array_equal(here.points, there.points)
    sides = sorted(line.whole.middle[0] for line in cuts_of(wider).lines if line.kind == "side")
    np.testing.assert_allclose(sides, [-wider.width / 2, wider.width / 2])


@pytest.mark.parametrize("spacing", [1e-5, 10.0])
def test_however_close_or_far_the_camera_a_stretch_has_some_cuts_and_not_too_many(
    spacing: float, epal: PalletModel
) -> None:
    cuts = face_cuts(epal, spacing, spacing, False)
    stretches = sum(len(line.edges) for line in cuts.lines)
    assert len(cuts.inner) == stretches * (MOST_CUTS if spacing < 1e-3 else FEWEST_CUTS)
