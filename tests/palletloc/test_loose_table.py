from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.geometry import FloatArray, LevelPose
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, place_plane
from palletloc.projection import MAX_ERROR_PX, Projector
from palletloc.remap_table import Interpolation, RemapTable, exact_map

GRID = PlaneGrid.spanning(-2.0, 4.0, -0.3, 0.9, 0.012)
Mounted = Callable[..., RigidTransform]


def beside(mounted: Mounted, distance: float, yaw_deg: float = 3.0) -> RigidTransform:
    """The camera's view of a plane on its left, the camera turned in its mounting."""
    camera_from_forklift = mounted(0.3, -0.1, 1.8, yaw_deg, 1.0, -0.5).inv()
    return place_plane(camera_from_forklift, LevelPose(0.3, distance - 0.1, 0.0, np.pi / 2), PALLET_FROM_VERTICAL)


def error_px(
    table: RemapTable, camera: CameraModel, camera_from_plane: RigidTransform, grid: PlaneGrid
) -> FloatArray:
    exact = exact_map(camera, camera_from_plane, grid)
    away = (table.pixels() - exact.pixels)[table.valid & exact.valid]
    if camera.period_px is not None:
        away[:, 0] -= camera.period_px * np.round(away[:, 0] / camera.period_px)
    lengths: FloatArray = np.linalg.norm(away, axis=-1)
    return lengths


@pytest.mark.parametrize("size", [(1920, 960), (3840, 1920)])
@pytest.mark.parametrize("distance", [0.4, 0.8, 1.6, 3.0])
@pytest.mark.parametrize("yaw_deg", [3.0, -90.0], ids=["ahead", "across_the_seam"])
def test_a_loose_table_is_within_its_error_of_the_exact_map(
    size: tuple[int, int], distance: float, yaw_deg: float, mounted: Mounted
) -> None:
    camera, camera_from_plane = Equirectangular(*size), beside(mounted, distance, yaw_deg)
    table = coarse_table(Projector(camera), camera_from_plane, GRID)
    assert table.complete
    assert table.places.shape == (GRID.rows, GRID.columns, 2)
    assert error_px(table, camera, camera_from_plane, GRID).max() < 1.1 * MAX_ERROR_PX


def test_at_an_ordinary_distance_the_table_is_loose_and_shows_the_same(mounted: Mounted) -> None:
    camera, camera_from_plane = Equirectangular(3840, 1920), beside(mounted, 1.9)
    projector = Projector(camera)
    table, exact = coarse_table(projector, camera_from_plane, GRID), projector.table(camera_from_plane, GRID)
    assert (
        error_px(table, camera, camera_from_plane, GRID).max()
        > error_px(exact, camera, camera_from_plane, GRID).max()
    )
    columns, rows = np.meshgrid(np.arange(3840), np.arange(1920))
    image = (127 + 60 * np.sin(columns / 40) + 60 * np.sin(rows / 40)).astype(np.uint8)
    shown = [one.apply(image, Interpolation.LINEAR).astype(int) for one in (table, exact)]
    assert np.abs(shown[0] - shown[1]).max() < 4


def test_where_the_camera_does_not_see_all_of_the_plane_the_exact_table_is_taken(mounted: Mounted) -> None:
    camera, camera_from_plane = Pinhole(640, 480, 400.0, 400.0, 319.5, 239.5), beside(mounted, 1.5, 85.0)
    projector = Projector(camera)
    table = coarse_table(projector, camera_from_plane, GRID)
    assert table is projector.table(camera_from_plane, GRID)
    assert not table.complete
    assert table.valid.any()


def test_the_table_cannot_be_written_to(mounted: Mounted) -> None:
    table = coarse_table(Projector(Equirectangular(1920, 960)), beside(mounted, 2.0), GRID)
    assert not table.places.flags.writeable
