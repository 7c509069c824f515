"""Edges in pictures are where projected points of the solids are; rays see what is there."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.choices import CameraKind
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.rays import camera_rays
from palletloc.synthetic.rendering import RenderedImage, lit, look, render
from palletloc.synthetic.rig import camera_of
from palletloc.synthetic.scene import Box, Material
from palletloc.synthetic.tracing import CEILING, FLOOR, WALLS, trace

BLACK = Material((0.0, 0.0, 0.0))
RED = Material((0.0, 0.0, 0.7))
Scenes = Callable[[list[Any]], Any]
Poses = Callable[..., Any]

CLOSE = 0.02  # px: rays that pass a surface closer than a hundredth of a pixel hit it
PLACE = LevelPose(2.0, 0.1, 0.6, 0.12)
EQUIRECTANGULAR, PINHOLE = Equirectangular(1000, 500), Pinhole(640, 480, 420.0, 420.0, 319.5, 239.5)


def face_line(start: tuple[float, float], end: tuple[float, float]) -> FloatArray:
    """World points of a line on the front face, from right and up in its plane."""
    share = np.linspace(0.0, 1.0, 4000)[:, None]
    right, up = (np.array(start) * (1 - share) + np.array(end) * share).T
    return PLACE.transform().apply(np.stack([np.zeros_like(up), -right, up], -1))


def crossings(camera: CameraModel, world_from_camera: Any, points: FloatArray, axis: int) -> FloatArray:
    """Where a projected line crosses the middle of columns or rows: their number, the other coordinate."""
    pixels = camera.project(world_from_camera.inv().apply(points)).pixels
    order = np.argsort(pixels[:, axis])
    along, across = pixels[order, axis], pixels[order, 1 - axis]
    whole = np.arange(np.ceil(along[0]), np.floor(along[-1]) + 1)
    return np.stack([whole, np.interp(whole, along, across)], -1)


def edges_of(model: PalletModel) -> dict[str, tuple[tuple[float, float], tuple[float, float], int]]:
    """Edges of the face: start, end, and the image axis that they run along."""
    half, gap = model.width / 2, 0.01
    first = model.openings[0]
    left, right = first.center - first.width / 2, first.center + first.width / 2
    low, high = first.bottom, first.bottom + first.height
    return {
        "top": ((-half + gap, model.height), (half - gap, model.height), 0),
        "bottom": ((-half + gap, 0.0), (left - gap, 0.0), 0),
        "left": ((-half, gap), (-half, model.height - gap), 1),
        "opening_top": ((left + gap, high), (right - gap, high), 0),
        "opening_left": ((left, low + gap), (left, high - gap), 1),
    }


# from where nothing but the front face meets at the edge: not the top, not the inside of the opening
VIEWS = {
    **dict.fromkeys(("top", "bottom", "left"), (0.9, 0.1, 0.67, 4.0)),
    "opening_top": (0.9, 0.1, 0.74, 4.0),
    "opening_left": (0.9, 0.9, 0.67, -20.0),
}


@pytest.mark.parametrize("camera", [EQUIRECTANGULAR, PINHOLE], ids=["equirectangular", "pinhole"])
@pytest.mark.parametrize("edge", VIEWS)
def test_solids_change_between_the_pixels_around_a_projected_edge(
    camera: CameraModel, edge: str, closed_below: PalletModel, hall: Scenes, mounted: Poses
) -> None:
    *position, yaw = VIEWS[edge]
    world_from_camera = mounted(*position, yaw, 1.0, 0.5)
    thin = PalletModel("thin", closed_below.width, closed_below.height, 0.02, closed_below.openings)
    scene = lit(hall([PalletBody(PLACE, thin, BLACK)]))
    solids = render(scene, camera_rays(camera), world_from_camera, smooth=False).solids
    start, end, axis = edges_of(thin)[edge]
    found = 0
    for whole, across in crossings(camera, world_from_camera, face_line(start, end), axis):
        if abs(across - np.round(across)) < CLOSE:
            continue
        line = solids[:, int(whole)] if axis == 0 else solids[int(whole)]
        before, after = line[int(np.floor(across))] == 0, line[int(np.floor(across)) + 1] == 0
        assert before != after, f"no change at {across:.3f} of line {whole}"
        found += 1
    assert found >= 10


def test_the_mean_over_a_pixel_places_an_edge_far_below_a_pixel(
    closed_below: PalletModel, hall: Scenes, mounted: Poses
) -> None:
    world_from_camera = mounted(0.7, 0.1, 0.67, 5.0, 0.0, 2.0)
    scene = lit(hall([PalletBody(PLACE, closed_below, BLACK)]))
    light = render(scene, camera_rays(PINHOLE), world_from_camera).radiance[:, :, 1]
    start, end, axis = edges_of(closed_below)["top"]
    errors = []
    for column, row in crossings(PINHOLE, world_from_camera, face_line(start, end), axis):
        top = int(row) - 6
        window = light[top : int(row) + 6, int(column)]
        bright = window[:4].mean()  # the wall above; the face below is black
        errors.append(top - 0.5 + window.sum() / bright - row)
    assert len(errors) > 200
    assert abs(np.mean(errors)) < 0.02
    assert np.std(errors) < 0.12  # four rays stand for a pixel


def test_the_rounding_of_an_edge_hides_what_geometry_says(hall: Scenes, mounted: Poses) -> None:
    radius, camera = 0.1, Pinhole(800, 800, 700.0, 700.0, 399.5, 399.5)
    ball = Box(LevelPose(2.0, 0.0, 1.0, 0.3), (0.2, 0.2, 0.2), BLACK, rounding=radius)
    picture = render(lit(hall([ball])), camera_rays(camera), mounted(0.0, 0.0, 1.0), smooth=False)
    seen = np.sqrt((picture.solids == 0).sum() / np.pi)
    assert seen == pytest.approx(700.0 * radius / np.sqrt(4.0 - radius**2), rel=0.004)


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearer_of_two_solids_of_one_shape_is_seen(order: int, hall: Scenes, mounted: Poses) -> None:
    near, far = (Box(LevelPose(x, 0.0, 1.0, 0.0), (0.2, 0.2, 0.2), RED, rounding=0.1) for x in (2.0, 2.1))
    balls = [near, far][::order]
    picture = render(lit(hall(balls)), camera_rays(PINHOLE), mounted(0.0, 0.02, 1.0), smooth=False)
    assert (picture.solids == balls.index(near)).sum() > 1000
    assert (picture.solids == balls.index(far)).sum() < 50


def centre(picture: RenderedImage) -> int:
    return int(picture.solids[picture.solids.shape[0] // 2, picture.solids.shape[1] // 2])


def test_what_is_behind_is_seen_through_an_opening(closed_below: PalletModel, hall: Scenes, mounted: Poses) -> None:
    camera = Pinhole(41, 41, 400.0, 400.0, 20.0, 20.0)
    pallet = PalletBody(LevelPose(2.0, 0.0, 0.0, 0.0), closed_below, BLACK)
    behind = Box(LevelPose(3.2, 0.264, 0.1, 0.0), (0.1, 0.3, 0.2), RED)
    into = mounted(1.0, 0.264, 0.075)
    assert centre(render(lit(hall([pallet, behind])), camera_rays(camera), into)) == 1
    assert centre(render(lit(hall([pallet])), camera_rays(camera), into)) == WALLS
    at_block = mounted(1.0, 0.0, 0.075)
    assert centre(render(lit(hall([pallet, behind])), camera_rays(camera), at_block)) == 0


def test_the_inner_wall_of_an_opening_is_seen_at_its_own_depth(
    closed_below: PalletModel, hall: Scenes, mounted: Poses
) -> None:
    pallet = PalletBody(LevelPose(0.0, 0.0, 0.0, 0.0), closed_below, BLACK)
    opening = closed_below.openings[1]
    inner_wall = -(opening.center + opening.width / 2)  # y of its right side, seen from the aisle
    camera_at, target = np.array([-1.0, -0.1, 0.07]), np.array([0.05, inner_wall, 0.07])
    direction = (target - camera_at) / np.linalg.norm(target - camera_at)
    yaw = np.degrees(np.arctan2(direction[1], direction[0]))
    camera = Pinhole(3, 3, 3000.0, 3000.0, 1.0, 1.0)
    rays = camera_rays(camera).parts[0].rays
    pose = mounted(*camera_at, yaw).as_matrix()
    _, hits = look(lit(hall([pallet])), rays.moved(pose[:3, :3], pose[:3, 3]), 1e-3)
    assert hits.solids[4] == 0
    assert hits.distances[4] == pytest.approx(np.linalg.norm(target - camera_at), abs=1e-3)


@pytest.mark.parametrize(("name", "expected"), [("closed_below", 0), ("open_below", FLOOR)])
def test_the_floor_is_seen_in_openings_that_reach_it(
    name: str, expected: int, request: pytest.FixtureRequest, hall: Scenes, mounted: Poses
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    pallet = PalletBody(LevelPose(2.0, 0.0, 0.0, 0.0), model, BLACK)
    # towards a point just inside the opening, 5 mm above the floor
    height, ahead = 0.3, 1.02
    pitch = float(np.degrees(np.arctan2(height - 0.005, ahead)))
    pose = mounted(1.0, -model.openings[0].center, height, 0.0, pitch)
    camera = Pinhole(41, 41, 2000.0, 2000.0, 20.0, 20.0)
    assert centre(render(lit(hall([pallet])), camera_rays(camera), pose)) == expected


def test_floor_walls_and_ceiling_are_told_apart_and_edges_on_the_seam_are_smooth(
    hall: Scenes, mounted: Poses
) -> None:
    solids = render(lit(hall([])), camera_rays(Equirectangular(64, 32)), mounted(0.0, 0.0, 1.5)).solids
    for row, surface in ((0, CEILING), (16, WALLS), (-1, FLOOR)):
        assert (solids[row] == surface).all()
    # turned by a half circle, the seam is where the middle was
    scene = lit(hall([Box(LevelPose(3.0, 0.0, 1.0, 0.3), (0.4, 0.4, 2.0), RED)]))
    rays = camera_rays(Equirectangular(256, 128))
    middle = render(scene, rays, mounted(0.0, 0.0, 1.0, 4.05)).radiance
    seam = render(scene, rays, mounted(0.0, 0.0, 1.0, 184.05)).radiance
    assert np.abs(np.roll(seam, 128, axis=1) - middle).max() < 0.01


@pytest.mark.parametrize("kind", [CameraKind.DUAL_FISHEYE, CameraKind.KANNALA_BRANDT, CameraKind.PINHOLE])
def test_all_cameras_see_the_same_scene(
    kind: CameraKind, closed_below: PalletModel, hall: Scenes, mounted: Poses
) -> None:
    things = [
        PalletBody(PLACE, closed_below, Material((0.1, 0.3, 0.5))),
        Box(LevelPose(2.5, 1.2, 0.5, 0.5), (0.5, 0.6, 1.0), RED),
        Box(LevelPose(1.5, -1.5, 0.3, -0.4), (0.4, 0.4, 0.6), RED, rounding=0.05),
    ]
    scene, pose = lit(hall(things)), mounted(0.2, 0.0, 1.2, 10.0, 8.0)
    whole, part = Equirectangular(1024, 512), camera_of(kind, 512)
    wide = render(scene, camera_rays(whole), pose, smooth=False)
    rays = camera_rays(part)
    narrow = render(scene, rays, pose, smooth=False)
    matched = 0
    for portion in rays.parts:
        matrix = pose.as_matrix()
        moved = portion.rays.moved(matrix[:3, :3], matrix[:3, 3])
        hits = trace(moved, scene.scene.solids, scene.spheres, scene.scene.room)
        points = moved.points(np.arange(moved.count), hits.distances).T.astype(np.float64)
        pixels = np.round(whole.project(pose.inv().apply(points)).pixels).astype(int)
        column, row = pixels[:, 0] % 1024, np.clip(pixels[:, 1], 0, 511)
        here = narrow.solids.ravel()[portion.pixels]
        same = wide.solids[row, column] == here
        assert same.mean() > 0.97  # all but pixels next to edges
        light = narrow.radiance.reshape(-1, 3)[portion.pixels]
        near = np.abs(wide.radiance[row, column] - light).max(axis=1) < 0.03
        assert near[same].mean() > 0.97
        matched += int((here >= 0).sum())
    assert matched > 1000


def test_a_camera_that_sees_nothing_is_refused() -> None:
    class Blind:
        width, height, period_px = 4, 4, None

        def unproject(self, pixels: FloatArray) -> Any:
            shape = (*pixels.shape[:-1], 3)
            return np.full(shape, np.nan), np.zeros(shape), pixels[..., 0] > 9

    with pytest.raises(ValueError, match="sees nothing"):
        camera_rays(Blind())  # type: ignore[arg-type]
