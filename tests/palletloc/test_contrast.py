from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from palletloc.contrast import Placing, least_contrast, opening_contrasts, place_contrasts
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.matching import smoothed
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import Shot

GRID = PlaneGrid.spanning(-0.66, 0.66, -0.06, 0.21, 0.004)
STRAIGHT = np.array([0.0, 0.0, 3.0])
Draw = Callable[..., PlaneView]


def face_contrast(view: PlaneView, model: PalletModel) -> float:
    """The contrast on a view of the face at its pose."""
    return contrast_at(smoothed(view.image, view.grid.resolution), view.grid, model)


def contrast_at(image: Image, grid: PlaneGrid, model: PalletModel, placing: Placing = lambda points: points) -> float:
    """The contrast at a single place."""
    return float(place_contrasts(image, grid, model, lambda points: placing(points)[None])[0])


def noisy(view: PlaneView, sigma: float = 4.0) -> PlaneView:
    noise = np.random.default_rng(0).normal(0.0, sigma, view.image.shape)
    return replace(view, image=np.clip(view.image + noise, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("levels", [(90.0, 180.0, 30.0), (90.0, 60.0, 200.0)], ids=["dark", "bright"])
def test_openings_that_are_not_like_the_blocks_stand_out(
    model: PalletModel, levels: tuple[float, ...], draw_face: Draw
) -> None:
    assert face_contrast(noisy(draw_face(model, GRID, STRAIGHT, levels=levels)), model) > 5.0


def test_without_openings_the_contrast_is_about_one(epal: PalletModel, draw_face: Draw) -> None:
    board = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 150.0, 150.0)), 12.0)
    assert face_contrast(board, epal) < 1.5


def test_the_less_clear_opening_counts(epal: PalletModel, draw_face: Draw) -> None:
    view = noisy(draw_face(epal, GRID, STRAIGHT))
    half = view.image.copy()
    half[:, GRID.columns // 2 :] = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 180.0, 180.0))).image[
        :, GRID.columns // 2 :
    ]
    assert face_contrast(replace(view, image=half), epal) < 1.5
    assert face_contrast(replace(view, image=half[:, ::-1]), epal) < 1.5


def test_one_opening_aside_blocks_are_no_longer_alike(epal: PalletModel, draw_face: Draw) -> None:
    right = noisy(draw_face(epal, GRID, STRAIGHT))
    aside = noisy(draw_face(epal, GRID, STRAIGHT, (0.26, 0.0)))
    assert face_contrast(aside, epal) < 0.4 * face_contrast(right, epal)


def test_blocks_that_differ_from_each_other_weaken_the_contrast(epal: PalletModel, draw_face: Draw) -> None:
    view = noisy(draw_face(epal, GRID, STRAIGHT))
    ramp = np.linspace(-60.0, 60.0, GRID.columns)
    uneven = replace(view, image=np.clip(view.image + ramp, 0, 255).astype(np.uint8))
    assert face_contrast(uneven, epal) < 0.5 * face_contrast(view, epal)


def test_colour_tells_what_gray_does_not(epal: PalletModel, draw_face: Draw) -> None:
    blue = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 170.0, 90.0))).image
    red = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 90.0, 170.0))).image
    view = draw_face(epal, GRID, STRAIGHT)
    colour = replace(view, image=np.dstack([blue, np.full_like(blue, 120), red]))
    gray = replace(view, image=((blue.astype(int) + red) // 2).astype(np.uint8))
    assert face_contrast(colour, epal) > 5.0
    assert face_contrast(gray, epal) < 2.0


def test_half_the_light_gives_nearly_the_same(t11: PalletModel, draw_face: Draw) -> None:
    view = draw_face(t11, GRID, STRAIGHT)
    uneven = np.clip(view.image + np.linspace(-30.0, 30.0, GRID.columns), 0, 255).astype(np.uint8)
    bright, dark = (face_contrast(replace(view, image=image), t11) for image in (uneven, uneven // 2))
    assert dark == pytest.approx(bright, rel=0.1)


def test_a_plain_image_has_no_contrast(epal: PalletModel) -> None:
    plain = np.full((GRID.rows, GRID.columns), 77, np.uint8)
    assert contrast_at(plain, GRID, epal) == 0.0


def test_the_face_is_looked_for_where_its_points_are_placed(epal: PalletModel, draw_face: Draw) -> None:
    wide = PlaneGrid.spanning(-1.5, 1.5, -0.4, 0.6, 0.005)
    camera, place, scale = np.array([-0.3, 1.5, 2.0]), (0.3, 0.1), 1.06
    view = draw_face(epal, wide, camera, place, scale)

    def placing(points: FloatArray) -> FloatArray:
        scaled: FloatArray = camera[:2] + (points + place - camera[:2]) / scale
        return scaled

    image = smoothed(noisy(view).image, wide.resolution)
    assert contrast_at(image, wide, epal, placing) > 5.0
    assert contrast_at(image, wide, epal) < 3.0


@pytest.mark.parametrize("shift", [(3.0, 0.0), (-3.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-0.9, 0.0)])
def test_beyond_the_view_there_is_no_contrast(shift: tuple[float, float], epal: PalletModel, draw_face: Draw) -> None:
    image = noisy(draw_face(epal, GRID, STRAIGHT)).image
    assert contrast_at(image, GRID, epal, lambda points: points + shift) == 0.0


def test_many_places_at_once_are_each_looked_at_alone(epal: PalletModel, draw_face: Draw) -> None:
    view = noisy(draw_face(epal, GRID, STRAIGHT))
    shifts = np.array([[0.0, 0.0], [0.05, 0.0], [0.26, 0.01], [0.0, 0.03], [9.0, 0.0]])
    together = place_contrasts(view.image, GRID, epal, lambda points: points + shifts[:, None])
    for i, contrast in enumerate(together):
        assert contrast == pytest.approx(contrast_at(view.image, GRID, epal, partial(np.add, shifts[i])), rel=1e-5)
    assert together[-1] == 0.0
    assert len(place_contrasts(view.image, GRID, epal, lambda points: points[None][:0])) == 0


# At a pose, on a view of its surroundings.

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
WHOLE = (-9.0, 9.0)


@pytest.fixture
def patch(portrait: Callable[..., Shot], epal: PalletModel) -> FacePatch:
    found = view_patch(portrait(epal, POSE), POSE, (-0.9, 0.9, -0.15, 0.3), 0.005)
    assert isinstance(found, FacePatch)
    return found


def test_each_opening_is_compared_with_the_blocks_beside_it(patch: FacePatch, epal: PalletModel) -> None:
    both = opening_contrasts(patch, epal, POSE)
    assert both.shape == (2,)
    assert least_contrast(patch, epal, POSE) == both.min() > 1.5
    left, _ = epal.openings
    boarded = patch.smooth.copy()
    grid = patch.view.grid
    (first, low), (last, high) = np.rint(
        grid.pixels(np.array([[left.left - 0.01, left.bottom - 0.01], [left.right + 0.01, left.top + 0.01]]))
    ).astype(int)
    row, column = np.rint(grid.pixels(np.array([0.0, 0.07]))).astype(int)[::-1]
    boarded[high : low + 1, first : last + 1] = boarded[row, column]
    closed = opening_contrasts(replace(patch, smooth=boarded), epal, POSE)
    assert closed[0] < 1.0 < closed[1] == pytest.approx(both[1], rel=0.3)


def test_one_opening_aside_the_contrast_at_a_pose_is_lost(patch: FacePatch, epal: PalletModel) -> None:
    pitch = epal.openings[1].center - epal.openings[0].center
    aside = replace(
        POSE, x=POSE.x + float(np.sin(POSE.yaw)) * pitch / 2, y=POSE.y - float(np.cos(POSE.yaw)) * pitch / 2
    )
    assert least_contrast(patch, epal, aside) < 0.5 * least_contrast(patch, epal, POSE)


def test_what_is_hidden_does_not_count(patch: FacePatch, epal: PalletModel) -> None:
    left, right = epal.openings
    before = (left.left - 0.03, left.right + 0.03)
    covered = patch.smooth.copy()
    grid = patch.view.grid
    first, last = np.rint(grid.pixels(np.array([[before[0], 0.0], [before[1], 0.0]])))[:, 0].astype(int)
    covered[:, first : last + 1] = 128
    hidden = replace(patch, smooth=covered)
    alone = float(opening_contrasts(patch, epal, POSE)[1])
    assert least_contrast(hidden, epal, POSE) < 0.5 * alone
    for spans in ({"hidden": [before]}, {"occluders": [before]}):
        assert least_contrast(hidden, epal, POSE, **spans) == pytest.approx(alone, rel=0.3)
    assert right.left > before[1]


def test_something_before_all_openings_leaves_no_contrast_unless_it_is_only_seen_to_stand_there(
    patch: FacePatch, epal: PalletModel
) -> None:
    assert least_contrast(patch, epal, POSE, [WHOLE]) == 0.0
    assert least_contrast(patch, epal, POSE, (), [WHOLE]) == least_contrast(patch, epal, POSE)


def test_where_the_view_does_not_reach_there_is_no_number(patch: FacePatch, epal: PalletModel) -> None:
    assert np.isnan(least_contrast(patch, epal, replace(POSE, x=POSE.x + 3.0)))
    assert np.isnan(opening_contrasts(patch, epal, replace(POSE, z=1.0))).all()
