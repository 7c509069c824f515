from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.consistency_tables import FACTORS, class_table, factor_table
from benchmarks.run_parts import between
from benchmarks.scenes import draw_scene
from benchmarks.tables import Section, Value
from benchmarks.views import HeightClass, ShotViews, View
from palletloc import LevelPose, Method
from palletloc.evaluation.pose_error import PalletEstimate, PoseError, TrueFace
from palletloc.evaluation.run_match import match_shot

FULL, HALF = draw_scene(0), draw_scene(1)


def view(
    nees: float | None, height: HeightClass = HeightClass.FLOOR, refused: bool = False, full: bool = True
) -> View:
    scene = FULL if full else HALF
    face = TrueFace("A", scene.spec.aisle.models[0].name, LevelPose(1.0, 2.0, 0.0, 1.5), 2.5, 1.8, True)
    estimate = PalletEstimate(0.0, face.model, face.forklift_from_pallet, np.eye(4))
    offset = np.array([0.01, -0.02, 0.0, np.radians(0.1)])
    error = None if nees is None else PoseError(0.0, estimate, face, offset, nees, np.eye(4), None)
    return View(scene, face, height, 0.0, error, refused)


def row(section: Section, *first: str) -> dict[str, Value]:
    names = [column.name for column in section.columns]
    return next(dict(zip(names, row, strict=True)) for row in section.rows if row[: len(first)] == first)


def table(shots: Sequence[ShotViews]) -> Section:
    return class_table(Method.PAPER, shots, "")


def test_each_class_and_size_counts_its_own() -> None:
    shots = [
        ShotViews(True, (view(1.0), view(3.0), view(None, refused=True), view(None)), (HeightClass.NEAR,)),
        ShotViews(True, (view(2.0, HeightClass.SAME),), ()),
        ShotViews(False, (view(9.0, full=False),), ()),
    ]
    floor = row(table(shots), "floor", "full size")
    assert (floor["views"], floor["recall"], floor["refused"], floor["false/shot"]) == (4, 0.5, 0.25, 0.0)
    assert row(table(shots), "near", "full size")["false/shot"] == 0.5
    assert row(table(shots), "same", "full size")["views"] == 1
    assert row(table(shots), "floor", "half size")["NEES"] == (9.0, 9.0, 9.0)
    assert len(table(shots).rows) == 4


def test_errors_have_their_columns_units_nees_its_percentiles_and_misses_nothing() -> None:
    floor = row(table([ShotViews(True, (view(1.0),), ())]), "floor")
    assert floor["yaw deg"] == pytest.approx((0.1, 0.1, 0.1))
    assert floor["depth mm"] == pytest.approx((10.0, 10.0, 10.0))
    assert floor["along mm"] == pytest.approx((20.0, 20.0, 20.0))
    views = tuple(view(float(nees)) for nees in range(101))
    nees = row(table([ShotViews(True, (*views, view(150.0)), ())]), "floor")["NEES"]
    assert nees == pytest.approx(((5050 + 150) / 102, 50.5, np.percentile([*range(101), 150], 95)))
    floor = row(table([ShotViews(True, (view(None),), ())]), "floor")
    assert (floor["recall"], floor["NEES"], floor["yaw deg"]) == (0.0, None, None)


def test_every_factor_splits_all_views_into_parts_in_order() -> None:
    views = (view(1.0), view(3.0, HeightClass.NEAR), view(None, full=False), view(2.0, full=False))
    section = factor_table(Method.PAPER, [ShotViews(True, views, ())])
    for name in FACTORS:
        rows = [row for row in section.rows if row[0] == name]
        assert sum(count for row in rows for count in (row[2], row[6]) if isinstance(count, int)) == len(views)
    sizes = row(section, "images", "full size")
    assert (sizes["floor: views"], sizes["other heights: views"]) == (1, 1)
    assert sizes["their NEES"] == (3.0, 3.0, 3.0)
    for factor in ("misfit", "gain", "blur px", "noise", "range m"):
        scenes = [draw_scene(seed) for seed in range(40)]
        drawn = [View(scene, view(1.0).face, HeightClass.FLOOR, 0.1, None, False) for scene in scenes]
        lows = [float(label.split()[0]) for label in sorted({FACTORS[factor](shown) for shown in drawn})]
        assert lows == sorted(lows)


def test_parts_by_height_hold_each_pallet_once() -> None:
    places = [LevelPose(2.0 * i, 2, z, 0) for i, z in enumerate((0.0, 1.2, 1.55, 2.4))]
    faces = [TrueFace(str(i), "t11", pose, 2.0, 1.8 - pose.z, True) for i, pose in enumerate(places)]
    found = [LevelPose(2.0 * i, 2 + 0.6 * (i == 1), z, 0) for i, z in enumerate((0.0, 1.2, 1.55))]
    shot = match_shot(0.0, [PalletEstimate(0.0, "t11", pose, np.eye(4)) for pose in found], faces)
    low, high = between(shot, 0.6, np.inf, 1.8), between(shot, -np.inf, 0.6, 1.8)
    assert [error.face.id for error in low.errors] == ["0"]
    assert [face.id for face in low.missed] == ["1"]
    assert [error.face.id for error in high.errors] == ["2"]
    assert [face.id for face in high.missed] == ["3"]
    assert (len(low.false), len(high.false)) == (1, 0)
