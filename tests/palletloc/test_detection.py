from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc import LevelPose, Mounting, PalletModel, ShelfPlane, Shot, load_library
from palletloc.detection import Detection, detect
from palletloc.geometry import FloatArray
from palletloc.matching import FULL, EdgeEnergy, edge_energy
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.shelf_view import DetectionConfig, ShelfPlaneError, ShelfView
from palletloc.template import FacePlacement, TemplatePiece, WeightedSums, face_template, match_template
from tests.palletloc.poses import Draw, Pallets

CONFIG = DetectionConfig()
SHELF = ShelfPlane(1.3, 2.0, -np.pi / 2, (0.0,))


def detected(
    shot: Shot, models: Sequence[PalletModel], shelf: ShelfPlane = SHELF
) -> tuple[list[Detection], list[ShelfView]]:
    return detect(shot, shelf, models, CONFIG)


def hits(found: Sequence[Detection], model: PalletModel, truth: LevelPose) -> list[int]:
    """Ranks of the detections of a model that are right to some centimetres and degrees."""
    good = []
    cos, sin = np.cos(truth.yaw), np.sin(truth.yaw)
    for rank, detection in enumerate(found):
        dx, dy, dz, turn = detection.forklift_from_pallet.minus(truth)
        along, depth = sin * dx - cos * dy, cos * dx + sin * dy
        near = abs(along) < 0.06 and abs(depth) < 0.12 and abs(dz) < 0.06
        if detection.model == model and near and abs(turn) < np.radians(6.0):
            good.append(rank)
    return good


@pytest.mark.parametrize(
    "off", [(0.0, 0.0), (0.08, 0.0), (-0.08, 0.0), (0.04, 1.5), (-0.04, -1.5)], ids=lambda off: f"{off}"
)
def test_a_plane_may_be_off_by_centimetres_and_a_degree(
    off: tuple[float, float], floor_shot: Shot, floor_pallets: Pallets
) -> None:
    shelf = replace(SHELF, y=SHELF.y + off[0], facing=SHELF.facing + np.radians(off[1]))
    found, views = detected(floor_shot, [model for model, _ in floor_pallets], shelf)
    assert len(views) == 1
    assert all(hits(found, model, pose) for model, pose in floor_pallets)


def test_the_most_promising_detection_of_each_model_is_its_pallet(floor_shot: Shot, floor_pallets: Pallets) -> None:
    for model, pose in floor_pallets:
        found, _ = detected(floor_shot, [model])
        assert hits(found, model, pose)[0] == 0
        promises = [detection.promise for detection in found]
        assert promises == sorted(promises, reverse=True)


def test_each_band_is_searched_and_without_levels_the_whole_plane(rack_shot: Shot, rack_pallets: Pallets) -> None:
    found, views = detected(rack_shot, [rack_pallets[0][0]], replace(SHELF, levels=()))
    assert len(views) == 1
    assert all(detection.level is None for detection in found)
    assert all(hits(found, model, pose) for model, pose in rack_pallets)
    levels = tuple(pose.z for _, pose in rack_pallets)
    found, views = detected(rack_shot, [rack_pallets[0][0]], replace(SHELF, levels=levels))
    assert len(views) == len(levels)
    assert all(detection.forklift_from_pallet.z == pytest.approx(detection.level, abs=1e-6) for detection in found)
    assert all(hits(found, model, pose) for model, pose in rack_pallets)


def test_detections_stand_apart_and_are_the_same_every_time(floor_shot: Shot, floor_pallets: Pallets) -> None:
    models = [model for model, _ in floor_pallets]
    found, _ = detected(floor_shot, models)
    for model in models:
        places = [detection.forklift_from_pallet for detection in found if detection.model == model]
        assert 0 < len(places) <= CONFIG.max_candidates
        for i, place in enumerate(places):
            for other in places[:i]:
                assert np.hypot(place.x - other.x, place.y - other.y) >= 0.9 * CONFIG.min_depth_spacing
    assert detected(floor_shot, models)[0] == detected(floor_shot, models)[0]


def test_the_mirrored_shelf_gives_mirrored_detections(floor_shot: Shot, floor_pallets: Pallets) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    matrix = mirror @ floor_shot.mounting.forklift_from_camera.as_matrix() @ mirror
    mounting = Mounting(RigidTransform.from_matrix(matrix))
    shot = replace(floor_shot, image=np.ascontiguousarray(floor_shot.image[:, ::-1]), mounting=mounting)
    shelf = replace(SHELF, y=-SHELF.y, facing=-SHELF.facing)
    found, _ = detected(shot, [model for model, _ in floor_pallets], shelf)
    for model, pose in floor_pallets:
        assert hits(found, model, LevelPose(pose.x, -pose.y, pose.z, -pose.yaw))


def test_a_plain_image_or_far_shelf_has_nothing_and_one_behind_is_refused(
    blank_shot: Shot, epal: PalletModel, floor_shot: Shot
) -> None:
    found, views = detected(blank_shot, [epal])
    assert found == []
    assert len(views) == 1
    for shelf in (ShelfPlane(1.3, 20.0, -np.pi / 2, (0.0,)), ShelfPlane(-4.0, 0.0, 0.0, (0.0,))):
        found, _ = detected(floor_shot, [epal], shelf)
        assert all(detection.score < 0.6 for detection in found)
    with pytest.raises(ShelfPlaneError):
        detected(floor_shot, [epal], replace(SHELF, facing=np.pi / 2))


def test_a_level_out_of_sight_keeps_no_other_from_being_searched(floor_shot: Shot, floor_pallets: Pallets) -> None:
    found, _ = detected(floor_shot, [model for model, _ in floor_pallets], replace(SHELF, levels=(0.0, 1.5, 9.0)))
    assert all(hits(found, model, pose) for model, pose in floor_pallets)
    assert all(detection.level != 9.0 for detection in found)


def test_yaws_that_may_be_surround_the_shelfs_and_every_pallets(floor_shot: Shot, floor_pallets: Pallets) -> None:
    for off in (-1.5, 0.0, 1.5):
        shelf = replace(SHELF, facing=SHELF.facing + np.radians(off))
        found, _ = detected(floor_shot, [model for model, _ in floor_pallets], shelf)
        for detection in found:
            low, high = detection.yaws
            assert low < detection.forklift_from_pallet.yaw < high
            assert (low + high) / 2 == pytest.approx(shelf.yaw)
            assert high - low > 2 * np.radians(CONFIG.plane_yaw_deg + CONFIG.pallet_yaw_deg)
            assert all(low < pose.yaw < high for _, pose in floor_pallets)


# Templates of faces.

RESOLUTION = 0.008
GRID = PlaneGrid.spanning(-1.1, 1.1, -0.35, 0.6, RESOLUTION)
CAMERA = np.array([-0.4, 1.7, 2.2])
WINDOW = (51, 25)
PLACES = np.arange(-0.3, 0.3, RESOLUTION / 2)


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)[:, None]


def here(scale: float = 1.0, yaw: float = 0.0, height: float = 0.0) -> FacePlacement:
    return FacePlacement(column(scale), column(yaw), column(height))


def template_of(view: PlaneView, model: PalletModel) -> list[TemplatePiece]:
    return face_template(model, edge_energy(view.image, WINDOW), view.grid.resolution)


def test_edges_weigh_one_in_all_and_blocks_count_against() -> None:
    blank = np.zeros((GRID.rows, GRID.columns), np.uint8)
    for model, camera in product(load_library().values(), (None, CAMERA)):
        pieces = face_template(model, EdgeEnergy(blank, blank), RESOLUTION, camera)
        weights = np.array([piece.weight for piece in pieces])
        assert weights[weights > 0].sum() == pytest.approx(1.0)
        wide = min(right - left for left, right in model.blocks) > 0.08
        assert (weights < 0).any() or not wide
        for piece in pieces:
            assert abs(piece.right) <= model.width / 2 + 0.03
            assert -0.03 <= piece.up <= model.height + 0.03


@pytest.mark.parametrize("fill", ["edges", "everything", "nothing"])
def test_the_score_is_one_where_all_edges_are_seen_and_nothing_else(fill: str, epal: PalletModel) -> None:
    full = np.full((GRID.rows, GRID.columns), FULL, np.uint8)
    pieces = face_template(epal, EdgeEnergy(full, full), RESOLUTION)
    if fill == "edges":
        pieces = [piece for piece in pieces if piece.weight > 0]
    if fill == "nothing":
        pieces = [piece._replace(field=0 * full) for piece in pieces]
    score = match_template(pieces, GRID, CAMERA, here(), np.zeros(1))
    blocks = sum(piece.weight for piece in pieces if piece.weight < 0)
    expected = {"edges": 1.0, "everything": 1.0 + blocks, "nothing": 0.0}[fill]
    assert score.shape == (1, 1)
    assert score[0, 0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.12, 0.05), (-0.21, -0.1)])
def test_a_face_is_found_where_it_is_drawn(place: tuple[float, float], epal: PalletModel, draw_face: Draw) -> None:
    view = draw_face(epal, GRID, CAMERA, place)
    heights = np.arange(-0.2, 0.2, RESOLUTION / 2)
    placement = FacePlacement(np.ones((len(heights), 1)), np.zeros((1, 1)), heights[:, None])
    score = match_template(template_of(view, epal), GRID, CAMERA, placement, PLACES)
    row, col = np.unravel_index(score.argmax(), score.shape)
    assert PLACES[col] == pytest.approx(place[0], abs=1.5 * RESOLUTION)
    assert heights[row] == pytest.approx(place[1], abs=1.5 * RESOLUTION)
    assert score.max() > 0.8


@pytest.mark.parametrize("scale", [0.9, 0.96, 1.05, 1.1])
@pytest.mark.parametrize("camera", [CAMERA, np.array([0.9, -1.2, 1.8])])
def test_a_face_at_another_distance_is_found_at_its_scale(
    scale: float, camera: FloatArray, epal: PalletModel, draw_face: Draw
) -> None:
    view = draw_face(epal, GRID, camera, (0.1, 0.02), scale)
    scales = np.arange(0.86, 1.14, 0.004)
    placement = FacePlacement(scales[:, None], np.zeros((1, 1)), np.full((1, 1), 0.02))
    score = match_template(template_of(view, epal), GRID, camera, placement, PLACES)
    row, col = np.unravel_index(score.argmax(), score.shape)
    assert scales[row] == pytest.approx(scale, abs=0.012)
    assert PLACES[col] == pytest.approx(0.1, abs=2 * RESOLUTION)
    assert score[row, col] > 0.7
    assert score[row, col] > score[np.abs(scales - 1.0).argmin()].max() + 0.1


@pytest.mark.parametrize("yaw", [-0.08, -0.04, 0.05])
def test_a_turned_face_is_found_at_its_yaw(yaw: float, epal: PalletModel, draw_face: Draw) -> None:
    view = draw_face(epal, GRID, CAMERA, (0.1, 0.0), yaw=yaw)
    yaws = np.arange(-0.12, 0.121, 0.01)
    placement = FacePlacement(np.ones((1, 1)).repeat(len(yaws), 0), yaws[:, None], np.zeros((1, 1)))
    score = match_template(template_of(view, epal), GRID, CAMERA, placement, PLACES)
    assert yaws[np.unravel_index(score.argmax(), score.shape)[0]] == pytest.approx(yaw, abs=0.021)
    assert score.max() > score[np.abs(yaws + yaw).argmin()].max() + 0.05  # the sign of the turn counts


def test_a_drift_moves_the_places_of_each_placement(epal: PalletModel, draw_face: Draw) -> None:
    template = template_of(draw_face(epal, GRID, CAMERA), epal)
    placement = FacePlacement(column(1.0, 0.95), np.zeros((1, 1)), np.zeros((1, 1)))
    places = np.array([0.0, 0.03])
    drifted = match_template(template, GRID, CAMERA, placement, places, column(0.02, -0.05))
    for row, drift in enumerate((0.02, -0.05)):
        single = FacePlacement(placement.scale[row : row + 1], np.zeros((1, 1)), np.zeros((1, 1)))
        np.testing.assert_allclose(
            drifted[row], match_template(template, GRID, CAMERA, single, places + drift)[0], atol=1e-6
        )


def test_a_face_an_opening_aside_scores_less_and_beyond_the_view_little(epal: PalletModel, draw_face: Draw) -> None:
    view = draw_face(epal, GRID, CAMERA)
    score = match_template(template_of(view, epal), GRID, CAMERA, here(), np.array([0.0, 0.5275, -0.5275]))[0]
    assert score[0] > max(score[1:]) + 0.2
    score = match_template(template_of(view, epal), GRID, CAMERA, here(height=3.0), np.array([-40.0, 40.0]))
    assert np.isfinite(score).all()
    assert score.max() < 0.3


def test_where_rounded_edges_are_seen_is_taken_into_account(t11: PalletModel) -> None:
    blank = np.zeros((GRID.rows, GRID.columns), np.uint8)
    energy = EdgeEnergy(blank, blank)
    drawn, seen = (face_template(t11, energy, RESOLUTION, camera) for camera in (None, CAMERA))
    moved = [(b.right - a.right, b.up - a.up) for a, b in zip(drawn, seen, strict=True) if a.weight > 0]
    assert max(np.hypot(*shift) for shift in moved) > 0.1 * t11.edge_radius
    assert max(np.hypot(*shift) for shift in moved) < 2 * t11.edge_radius


def test_places_may_outnumber_placements_and_each_is_scored_alike(epal: PalletModel, draw_face: Draw) -> None:
    template = template_of(draw_face(epal, GRID, CAMERA), epal)
    few = FacePlacement(np.linspace(0.95, 1.05, 3)[:, None], np.zeros((1, 1)), np.zeros((1, 1)))
    score = match_template(template, GRID, CAMERA, few, PLACES)
    assert score.shape == (3, len(PLACES))
    for column_of, place in enumerate(PLACES):
        single = match_template(template, GRID, CAMERA, few, np.array([place]))
        np.testing.assert_allclose(single[:, 0], score[:, column_of], atol=1e-6)


def test_weighted_sums_add_up_what_is_given_in_any_order() -> None:
    fields = np.random.default_rng(0).integers(0, FULL + 1, (6, 4, 5), dtype=np.uint8)
    weights = [0.1, -0.2, 0.1, 0.3, -0.2, 0.5]
    for order in (range(6), (5, 3, 1, 0, 2, 4)):
        sums = WeightedSums((4, 5))
        for i in order:
            sums.add(fields[i], weights[i])
        expected = sum(weight * field.astype(float) / FULL for weight, field in zip(weights, fields, strict=True))
        np.testing.assert_allclose(sums.total(), expected, atol=1e-6)
