"""Images that are mirrored, upside down or turned: what they show is not where they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot

Placed = tuple[PalletModel, LevelPose]
Scene = tuple[Shot, tuple[Placed, ...], ShelfPlane]
Scenes = Callable[[str], Scene]
Faults = Callable[..., list[str]]
Makes = Callable[..., Localizer]
Check = Callable[[str, Image, bool], None]

FEW = settings(max_examples=settings().max_examples * 4 // 100, phases=[Phase.generate])
heights = pytest.mark.parametrize(
    "known",
    [True, pytest.param(True, marks=pytest.mark.slow), pytest.param(False, marks=pytest.mark.slow)],
    ids=["level", "level-many", "free"],
)
"""Whether the levels are known; more examples are drawn with the slow tests."""
FLIPS = {"mirrored": (1, -1), "upside_down": (-1, 1), "half_turn": (-1, -1)}
"""Order of the rows and of the columns."""
MAX_START_TURN = 20.0
"""How far a start's yaw may be off, in degrees: pallets turned by less together with all else cannot be told."""

tilts = st.floats(10.0, 350.0)
turns = st.floats(2 * MAX_START_TURN, 360.0 - 2 * MAX_START_TURN)
lenses = st.sampled_from(["fisheye", "pinhole"])


@pytest.fixture(scope="session")
def displaced(scenes: Scenes, localizer: Makes, faults: Faults) -> Check:
    """Return a function that checks that an image in another position gives no wrong row."""

    def checked(name: str, image: Image, known: bool = True) -> None:
        shot, pallets, shelf = scenes(name)
        found, levels = localizer(pallets), shelf.levels if known else ()
        starts = [Start(model.name, pose) for model, pose in pallets]
        moved = replace(shot, image=image)
        assert faults(found.explain(moved, replace(shelf, levels=levels)), pallets) == []
        assert faults(found.explain_from(moved, starts, levels), pallets) == []

    return checked


def rotated(image: Image, turn_deg: float) -> Image:
    """Return the image turned about its middle, black where nothing is."""
    rows, columns = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), turn_deg, 1.0)
    return np.asarray(cv2.warpAffine(image, matrix, (columns, rows)), np.uint8)


def flipped(image: Image, flip: str) -> Image:
    rows, columns = FLIPS[flip]
    return np.ascontiguousarray(image[::rows, ::columns])


def flip_of(shot: Shot, flip: str) -> FloatArray:
    """Return the (4, 4) matrix that moves points in the forklift frame to where a flipped image shows them."""
    up, left = FLIPS[flip]
    forklift_from_camera = shot.mounting.forklift_from_camera.as_matrix()
    return np.asarray(forklift_from_camera @ np.diag([1.0, left, up, 1.0]) @ np.linalg.inv(forklift_from_camera))


def seen_in(shot: Shot, pallets: tuple[Placed, ...], flip: str) -> tuple[Placed, ...]:
    """Return where a flipped image shows the pallets: what is upside down begins where it ended."""
    seen = []
    for model, pose in pallets:
        matrix = flip_of(shot, flip) @ pose.matrix()
        x, y, z = (matrix @ [0.0, 0.0, model.height if FLIPS[flip][0] < 0 else 0.0, 1.0])[:3].tolist()
        seen.append((model, LevelPose(x, y, z, float(np.arctan2(matrix[1, 0], matrix[0, 0])))))
    return tuple(seen)


def shelf_in(shot: Shot, shelf: ShelfPlane, flip: str) -> ShelfPlane:
    """Return where a flipped image shows the shelf."""
    flips = flip_of(shot, flip)
    x, y = (flips @ [shelf.x, shelf.y, 0.0, 1.0])[:2].tolist()
    across, along = flips[:2, :2] @ [np.cos(shelf.facing), np.sin(shelf.facing)]
    return replace(shelf, x=x, y=y, facing=float(np.arctan2(along, across)))


@pytest.mark.parametrize("name", ["floor", "rack", "fisheye", "pinhole"])
def test_a_mirrored_image_gives_no_wrong_row_where_the_shelf_was(name: str, displaced: Check, scenes: Scenes) -> None:
    displaced(name, flipped(scenes(name)[0].image, "mirrored"), True)


@pytest.mark.parametrize("name", ["floor", "fisheye", "pinhole"])  # "rack" has a level near a pallet's mirror image
@pytest.mark.parametrize("flip", ["upside_down", "half_turn"])
def test_an_upside_down_image_gives_no_wrong_row(name: str, flip: str, displaced: Check, scenes: Scenes) -> None:
    displaced(name, flipped(scenes(name)[0].image, flip), True)


@pytest.mark.parametrize("name", ["fisheye", "pinhole"])  # mounted with little roll: its mirror image is a tilt
def test_a_mirrored_image_gives_no_wrong_row_where_the_shelf_would_be_mirrored(
    name: str, scenes: Scenes, localizer: Makes, faults: Faults
) -> None:
    shot, pallets, shelf = scenes(name)
    seen, mirrored = seen_in(shot, pallets, "mirrored"), replace(shot, image=flipped(shot.image, "mirrored"))
    found = localizer(pallets)
    starts = [Start(model.name, pose) for model, pose in seen]
    assert faults(found.explain_from(mirrored, starts, shelf.levels), seen) == []
    assert faults(found.explain(mirrored, shelf_in(shot, shelf, "mirrored")), seen) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["floor", "rack", "fisheye", "pinhole"])
@pytest.mark.parametrize("flip", FLIPS)
def test_at_any_height_a_flipped_image_gives_only_rows_that_are_right_in_it(
    flip: str, name: str, scenes: Scenes, localizer: Makes, faults: Faults
) -> None:
    shot, pallets, shelf = scenes(name)
    turned = replace(shot, image=flipped(shot.image, flip))
    explained = localizer(pallets).explain(turned, replace(shelf, levels=()))
    assert faults(explained, pallets + seen_in(shot, pallets, flip)) == []


@heights
@FEW
@given(name=lenses, turn_deg=tilts)
def test_no_turn_about_the_lens_gives_a_wrong_row(
    displaced: Check, scenes: Scenes, name: str, turn_deg: float, known: bool
) -> None:
    displaced(name, rotated(scenes(name)[0].image, turn_deg), known)


@heights
@FEW
@given(name=st.sampled_from(["floor", "rack"]), turn_deg=turns)
def test_no_turn_about_the_vertical_gives_a_wrong_row(
    displaced: Check, scenes: Scenes, name: str, turn_deg: float, known: bool
) -> None:
    image = scenes(name)[0].image
    displaced(name, np.roll(image, round(turn_deg / 360 * image.shape[1]), axis=1), known)
