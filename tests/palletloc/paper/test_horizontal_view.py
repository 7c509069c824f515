from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.horizontal_view import HorizontalView, YawConfig, horizontal_source, line_up, view_horizontal
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
CONFIG = YawConfig()
Portrait = Callable[..., Shot]


def viewed(
    shot: Shot, model: PalletModel, pose: LevelPose = POSE, source: YawSource = YawSource.BOTTOM
) -> HorizontalView:
    return view_horizontal(shot, pose, model, source, CONFIG)


@pytest.mark.parametrize("distance", [0.8, 2.0, 4.0])
def test_the_plane_is_below_level_or_above_as_the_pallet_is(distance: float, epal: PalletModel) -> None:
    far = distance / CONFIG.max_lever + epal.height + 0.01
    middle = epal.height / 2
    chosen = [horizontal_source(epal, np.array([0.4, height, distance]), CONFIG) for height in (far, middle, -far)]
    assert chosen == [YawSource.BOTTOM, YawSource.FACE, YawSource.TOP]


def test_the_farther_the_face_the_wider_the_band_without_a_plane(epal: PalletModel) -> None:
    heights = np.linspace(-2.0, 2.0, 401)
    without = [
        sum(horizontal_source(epal, np.array([0.4, z, distance]), CONFIG) is YawSource.FACE for z in heights)
        for distance in (1.5, 2.5, 3.5)
    ]
    assert 0 < without[0] < without[1] < without[2]


@pytest.mark.parametrize("source", [YawSource.BOTTOM, YawSource.TOP])
def test_the_plane_goes_level_through_the_edge(source: YawSource, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, source=source)
    assert seen.source is source
    assert seen.height == (0.0 if source is YawSource.BOTTOM else t11.height)
    forklift_from_plane = shot.mounting.forklift_from_camera * seen.view.camera_from_plane
    into = [np.cos(POSE.yaw), np.sin(POSE.yaw), 0.0]
    np.testing.assert_allclose(
        forklift_from_plane.apply(np.zeros(3)), [POSE.x, POSE.y, POSE.z + seen.height], atol=1e-9
    )
    np.testing.assert_allclose(forklift_from_plane.rotation.apply([0.0, 1.0, 0.0]), into, atol=1e-9)
    np.testing.assert_allclose(forklift_from_plane.apply(seen.plane_from_camera), shot.mounting.center, atol=1e-9)


@pytest.mark.parametrize("source", [YawSource.BOTTOM, YawSource.TOP])
def test_every_level_edge_of_the_face_lies_in_the_view(
    source: YawSource, portrait: Portrait, epal: PalletModel
) -> None:
    shot = portrait(epal, POSE)
    seen = viewed(shot, epal, source=source)
    grid, camera = seen.view.grid, seen.plane_from_camera
    low, high = grid.top - (grid.rows - 1) * grid.resolution, grid.top
    for height in (0.0, 0.022, 0.122, epal.height):
        # the edge's point over the plane, seen from the camera
        point = np.array([0.0, 0.0, height - seen.height])
        reached = camera + (point - camera) * camera[2] / (camera[2] - point[2])
        assert line_up(height - seen.height, camera) == pytest.approx(reached[1])
        assert low < reached[1] - CONFIG.search + 1e-9
        assert reached[1] + CONFIG.search - 1e-9 < high
    assert grid.left < -epal.width / 2


def test_an_edge_on_the_plane_is_where_it_is_and_a_higher_one_farther() -> None:
    camera = np.array([0.2, -2.0, 1.8])
    assert line_up(0.0, camera) == 0.0
    assert line_up(0.1, camera) > 0.05
    assert line_up(-0.1, camera) < -0.05


def test_a_place_farther_on_the_ray_gives_a_similar_picture(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    x, y, z = shot.mounting.center + 1.05 * (np.array([POSE.x, POSE.y, POSE.z]) - shot.mounting.center)
    places = ((1.0, POSE), (1.05, replace(POSE, x=x, y=y, z=z)))
    points = np.array([[0.3, 0.05, 0.0], [-0.4, -0.05, 0.0], [0.0, 0.1, 0.0]])
    near, far = (
        shot.camera.project(viewed(shot, t11, pose).view.camera_from_plane.apply(scale * points))
        for scale, pose in places
    )
    np.testing.assert_allclose(far.pixels, near.pixels, atol=1e-6)
