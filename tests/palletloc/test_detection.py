from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.detection import Detection, detect
from palletloc.geometry import LevelPose
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import DetectionConfig, ShelfPlaneError, ShelfView
from palletloc.shot import Shot

CONFIG = DetectionConfig()
SHELF = ShelfPlane(1.3, 2.0, -np.pi / 2, (0.0,))
Placed = tuple[PalletModel, LevelPose]


def detected(
    shot: Shot, models: Sequence[PalletModel], shelf: ShelfPlane = SHELF
) -> tuple[list[Detection], list[ShelfView]]:
    return detect(shot, shelf, models, CONFIG)


def hits(found: Sequence[Detection], model: PalletModel, truth: LevelPose) -> list[int]:
    """Ranks of the detections of a model that are right to some centimetres and degrees."""
    good = []
    cos, sin = np.cos(truth.yaw), np.sin(truth.yaw)
    for rank, one in enumerate(found):
        dx, dy, dz, turn = one.forklift_from_pallet.minus(truth)
        along, depth = sin * dx - cos * dy, cos * dx + sin * dy
        near = abs(along) < 0.06 and abs(depth) < 0.12 and abs(dz) < 0.06
        if one.model == model and near and abs(turn) < np.radians(6.0):
            good.append(rank)
    return good


@pytest.mark.parametrize(
    "off", [(0.0, 0.0), (0.08, 0.0), (-0.08, 0.0), (0.04, 1.5), (-0.04, -1.5)], ids=lambda off: f"{off}"
)
def test_pallets_are_found_with_the_plane_off_by_centimetres_and_a_degree(
    off: tuple[float, float], floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    shelf = replace(SHELF, y=SHELF.y + off[0], facing=SHELF.facing + np.radians(off[1]))
    models = [model for model, _ in floor_pallets]
    found, views = detected(floor_shot, models, shelf)
    assert len(views) == 1
    for model, pose in floor_pallets:
        assert hits(found, model, pose)


def test_the_most_promising_detection_of_each_model_is_its_pallet(
    floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    for model, pose in floor_pallets:
        found, _ = detected(floor_shot, [model])
        assert hits(found, model, pose)[0] == 0
        promises = [one.promise for one in found]
        assert promises == sorted(promises, reverse=True)


def test_without_levels_the_whole_plane_is_searched(rack_shot: Shot, rack_pallets: tuple[Placed, ...]) -> None:
    models = [rack_pallets[0][0]]
    found, views = detected(rack_shot, models, replace(SHELF, levels=()))
    assert len(views) == 1
    assert all(one.level is None for one in found)
    for model, pose in rack_pallets:
        assert hits(found, model, pose)


def test_with_levels_each_band_is_searched_for_what_stands_there(
    rack_shot: Shot, rack_pallets: tuple[Placed, ...]
) -> None:
    levels = tuple(pose.z for _, pose in rack_pallets)
    found, views = detected(rack_shot, [rack_pallets[0][0]], replace(SHELF, levels=levels))
    assert len(views) == len(levels)
    assert all(one.forklift_from_pallet.z == pytest.approx(one.level, abs=1e-6) for one in found)
    for model, pose in rack_pallets:
        assert hits(found, model, pose)


def test_detections_of_a_model_on_a_level_stand_apart(floor_shot: Shot, floor_pallets: tuple[Placed, ...]) -> None:
    models = [model for model, _ in floor_pallets]
    found, _ = detected(floor_shot, models)
    for model in models:
        places = [one.forklift_from_pallet for one in found if one.model == model]
        assert 0 < len(places) <= CONFIG.max_candidates
        for i, one in enumerate(places):
            for other in places[:i]:
                assert np.hypot(one.x - other.x, one.y - other.y) >= 0.9 * CONFIG.min_depth_spacing


def test_the_same_shot_gives_the_same_detections(floor_shot: Shot, floor_pallets: tuple[Placed, ...]) -> None:
    models = [model for model, _ in floor_pallets]
    assert detected(floor_shot, models)[0] == detected(floor_shot, models)[0]


def test_the_mirrored_shelf_gives_mirrored_detections(floor_shot: Shot, floor_pallets: tuple[Placed, ...]) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    matrix = mirror @ floor_shot.mounting.forklift_from_camera.as_matrix() @ mirror
    mounting = Mounting(RigidTransform.from_matrix(matrix))
    shot = replace(floor_shot, image=np.ascontiguousarray(floor_shot.image[:, ::-1]), mounting=mounting)
    shelf = replace(SHELF, y=-SHELF.y, facing=-SHELF.facing)
    found, _ = detected(shot, [model for model, _ in floor_pallets], shelf)
    for model, pose in floor_pallets:
        mirrored = LevelPose(pose.x, -pose.y, pose.z, -pose.yaw)
        assert hits(found, model, mirrored)


def test_nothing_is_found_in_a_plain_image(blank_shot: Shot, epal: PalletModel) -> None:
    found, views = detected(blank_shot, [epal])
    assert found == []
    assert len(views) == 1


def test_a_shelf_out_of_range_or_behind_has_nothing(floor_shot: Shot, epal: PalletModel) -> None:
    far = ShelfPlane(1.3, 20.0, -np.pi / 2, (0.0,))
    behind = ShelfPlane(-4.0, 0.0, 0.0, (0.0,))
    for shelf in (far, behind):
        found, _ = detected(floor_shot, [epal], shelf)
        assert all(one.score < 0.6 for one in found)


def test_a_level_too_high_to_be_seen_does_not_keep_the_others_from_being_searched(
    floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    models = [model for model, _ in floor_pallets]
    found, _ = detected(floor_shot, models, replace(SHELF, levels=(0.0, 1.5, 9.0)))
    for model, pose in floor_pallets:
        assert hits(found, model, pose)
    assert all(one.level != 9.0 for one in found)


def test_a_plane_behind_the_camera_is_refused(floor_shot: Shot, epal: PalletModel) -> None:
    with pytest.raises(ShelfPlaneError):
        detected(floor_shot, [epal], replace(SHELF, facing=np.pi / 2))


def test_the_yaws_that_may_be_surround_the_shelf_s_and_every_pallet_s(
    floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    for off in (-1.5, 0.0, 1.5):
        shelf = replace(SHELF, facing=SHELF.facing + np.radians(off))
        found, _ = detected(floor_shot, [model for model, _ in floor_pallets], shelf)
        for one in found:
            low, high = one.yaws
            assert low < one.forklift_from_pallet.yaw < high
            assert (low + high) / 2 == pytest.approx(shelf.yaw)
            assert high - low > 2 * np.radians(CONFIG.plane_yaw_deg + CONFIG.pallet_yaw_deg)
            assert all(low < pose.yaw < high for _, pose in floor_pallets)
