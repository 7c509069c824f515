"""Pallets that the image shows only in part: cut by its border, by the limit of a lens, or between two lenses."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc import LevelPose, Localizer, PalletModel, ShelfPlane, Shot, Start
from palletloc.cameras import CameraModel, KannalaBrandt, Pinhole
from palletloc.choices import CameraKind
from palletloc.geometry import FloatArray, Image
from palletloc.synthetic.rig import camera_of
from tests.palletloc.bad_input.drawn import HEIGHTS, Check, Scene, Scenes, few
from tests.palletloc.poses import Pallets, Photograph

FEW = few(5)
SEAM = LevelPose(0.3, -0.08, 1.85, 0.0)
"""Where a camera of two lenses stands."""

lenses = st.sampled_from(["fisheye", "pinhole"])
sides = st.sampled_from(["left", "right", "top", "bottom"])
places = st.floats(-0.3, 1.3)
which = st.integers(0, 1)


def face_points(model: PalletModel, pose: LevelPose) -> FloatArray:
    right, up = np.meshgrid(np.linspace(-0.5, 0.5, 21) * model.width, np.linspace(0, 1, 3) * model.height)
    return np.asarray(pose.transform().apply(np.stack([0 * right, -right, up], axis=-1).reshape(-1, 3)))


def cropped(camera: CameraModel, image: Image, side: str, at: int) -> tuple[CameraModel, Image]:
    """Return a camera with a smaller image and that image: one side is cut off at a column or row."""
    if not isinstance(camera, Pinhole | KannalaBrandt):
        raise TypeError("only an image with borders can be cut")
    if side in ("left", "right"):
        at = int(np.clip(at, 8, camera.width - 8))
        kept = np.s_[:, at:] if side == "left" else np.s_[:, :at]
        moved = at if side == "left" else 0
        width = camera.width - at if side == "left" else at
        return replace(camera, width=width, cx=camera.cx - moved), np.ascontiguousarray(image[kept])
    at = int(np.clip(at, 8, camera.height - 8))
    kept_rows = np.s_[at:] if side == "top" else np.s_[:at]
    moved = at if side == "top" else 0
    height = camera.height - at if side == "top" else at
    return replace(camera, height=height, cy=camera.cy - moved), np.ascontiguousarray(image[kept_rows])


@pytest.fixture(scope="session")
def measured(localizer: Callable[..., Localizer], faults: Callable[..., list[str]]) -> Check:
    """Return a function that checks the rows of a cut shot, detected and from right starts, and counts them."""

    def checked(shot: Shot, pallets: Pallets, shelf: ShelfPlane, known: bool = True) -> int:
        found, levels = localizer(pallets), shelf.levels if known else ()
        starts = [Start(model.name, pose) for model, pose in pallets]
        given = found.explain_from(shot, starts, levels)
        assert faults(given, pallets) == []
        assert faults(found.explain(shot, replace(shelf, levels=levels)), pallets) == []
        return len(given.measurements)

    return checked


def cut_by_border(scene: Scene, side: str, pallet: int, place: float, known: bool, measured: Check) -> int:
    shot, pallets, shelf = scene
    pixels, valid = shot.camera.project(shot.mounting.to_camera.apply(face_points(*pallets[pallet])))
    along = pixels[valid][:, 0 if side in ("left", "right") else 1]
    at = round(float(along.min() + place * np.ptp(along)))
    camera, image = cropped(shot.camera, shot.image, side, at)
    return int(measured(replace(shot, image=image, camera=camera), pallets, shelf, known))


@HEIGHTS
@FEW
@given(name=lenses, side=sides, pallet=which, place=places)
def test_no_cut_by_the_border_gives_a_wrong_row(
    scenes: Scenes, measured: Check, name: str, side: str, pallet: int, place: float, known: bool
) -> None:
    cut_by_border(scenes(name), side, pallet, place, known, measured)


def test_a_border_beside_the_pallets_changes_nothing(scenes: Scenes, measured: Check) -> None:
    assert cut_by_border(scenes("fisheye"), "bottom", 0, 1.8, True, measured) == 2


def cut_by_lens(scene: Scene, pallet: int, place: float, black: bool, known: bool, measured: Check) -> int:
    shot, pallets, shelf = scene
    camera = shot.camera
    assert isinstance(camera, KannalaBrandt)
    points = shot.mounting.to_camera.apply(face_points(*pallets[pallet]))
    off_axis = np.arccos(points[:, 0] / np.linalg.norm(points, axis=1))
    limit = float(off_axis.min() + place * np.ptp(off_axis))
    smaller = replace(camera, max_angle=min(limit, camera.max_angle))
    image = shot.image.copy()
    if black:
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        image[~smaller.unproject(np.stack([columns, rows], axis=-1).astype(np.float64)).valid] = 0
    return int(measured(replace(shot, image=image, camera=smaller), pallets, shelf, known))


@HEIGHTS
@FEW
@given(pallet=which, place=places, black=st.booleans())
def test_no_cut_by_the_limit_of_the_lens_gives_a_wrong_row(
    scenes: Scenes, measured: Check, pallet: int, place: float, black: bool, known: bool
) -> None:
    cut_by_lens(scenes("fisheye"), pallet, place, black, known, measured)


def test_a_lens_that_does_not_see_the_pallets_gives_no_row(scenes: Scenes, measured: Check) -> None:
    assert cut_by_lens(scenes("fisheye"), 1, -0.3, False, True, measured) == 0


@pytest.mark.parametrize("pallet", [pytest.param(0, marks=pytest.mark.slow), 1])
@pytest.mark.parametrize(
    "across", [0.0, *(pytest.param(share, marks=pytest.mark.slow) for share in (-0.5, -0.35, -0.2, 0.2, 0.35, 0.5))]
)
def test_a_pallet_between_two_lenses_gives_no_wrong_row(
    across: float, pallet: int, photograph: Photograph, floor_pallets: Pallets, scenes: Scenes, measured: Check
) -> None:
    model, pose = floor_pallets[pallet]
    x, y, _ = pose.transform().apply([0.0, across * model.width, 0.0])
    seam_deg = float(np.degrees(np.arctan2(y - SEAM.y, x - SEAM.x)))
    mounting = (SEAM.x, SEAM.y, SEAM.z, seam_deg, 0.9, -0.7)
    shot = photograph(floor_pallets, camera_of(CameraKind.DUAL_FISHEYE, 1000), mounting)
    measured(shot, floor_pallets, scenes("floor")[2])
