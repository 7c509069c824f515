from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from palletloc import PalletModel
from palletloc.contrast import Placing, least_contrast, opening_contrasts, place_contrasts
from palletloc.geometry import FloatArray, Image
from palletloc.matching import FULL, Energy, channel_sum, component_gradients, edge_energy, gradient_across, smoothed
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.refinement.patch import FacePatch, view_patch
from tests.palletloc.poses import POSE, Draw, Portrait, moved

WINDOW = (41, 21)


def step(row: float, low: float = 60.0, high: float = 180.0, shape: tuple[int, int] = (80, 120)) -> Image:
    """An image that is bright above an edge along its rows."""
    cover = np.clip(row + 0.5 - np.arange(shape[0], dtype=np.float64), 0.0, 1.0)
    column = low + (high - low) * cover
    return np.repeat(np.round(column).astype(np.uint8)[:, None], shape[1], axis=1)


def patchwork(seed: int) -> Image:
    """An image of patches that differ in brightness, softened a little."""
    patches = np.random.default_rng(seed).uniform(20.0, 250.0, (8, 12))
    return np.asarray(cv2.GaussianBlur(np.kron(patches, np.ones((10, 10))), (0, 0), 1.0), dtype=np.uint8)


def centroid(profile: FloatArray | Energy) -> float:
    return float((np.arange(len(profile)) * profile).sum() / profile.sum())


def test_gradients_of_a_ramp_are_its_slopes_and_the_strongest_channel_gives_them() -> None:
    columns, rows = np.meshgrid(np.arange(40), np.arange(30))
    along_rows, along_columns = component_gradients((3 * columns + 2 * rows).astype(np.uint8))
    inside = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(along_rows[inside], 3.0, atol=0.51)  # the image holds whole gray levels
    np.testing.assert_allclose(along_columns[inside], 2.0, atol=0.51)
    weak, strong = step(40.0, 100, 120), step(40.0, 20, 200)
    for order in ((weak, strong, weak), (strong, weak, weak)):
        for whole, single in zip(component_gradients(np.dstack(order)), component_gradients(strong), strict=True):
            np.testing.assert_allclose(whole, single, atol=1e-3)


@pytest.mark.parametrize("row", [40.0, 40.25, 39.6])
def test_the_gradient_across_a_step_is_centred_on_it(row: float) -> None:
    gradient = gradient_across(step(row), True, 1.5, 2.0)
    assert centroid(gradient[20:60, 60]) + 20 == pytest.approx(row, abs=0.01)
    assert gradient[20:60, 60].sum() == pytest.approx(120.0, rel=0.01)  # what the edge changes in all


def test_an_edge_is_seen_between_colours_of_one_brightness_and_not_across_its_direction() -> None:
    assert gradient_across(step(40.0), False, 1.5, 2.0).max() < 1e-3
    np.testing.assert_allclose(
        gradient_across(step(40.0).T, False, 1.5, 2.0), gradient_across(step(40.0), True, 1.5, 2.0).T, atol=1e-3
    )
    up, down = step(40.0, 60, 180), step(40.0, 180, 60)
    gradient = gradient_across(np.dstack([up, down, np.full_like(up, 90)]), True, 1.5, 2.0)
    single = gradient_across(up, True, 1.5, 2.0)
    np.testing.assert_allclose(gradient, np.sqrt(2.0) * single, rtol=1e-3, atol=1e-2)


def test_smoothing_along_an_edge_averages_what_varies_there() -> None:
    noise = np.random.default_rng(0).normal(0.0, 12.0, (80, 120))
    noisy = np.clip(step(40.0) + noise, 0, 255).astype(np.uint8)
    quiet = np.delete(gradient_across(noisy, True, 1.0, 8.0), np.s_[30:50], axis=0).mean()
    loud = np.delete(gradient_across(noisy, True, 1.0, 0.3), np.s_[30:50], axis=0).mean()
    assert quiet < 0.5 * loud


@pytest.mark.parametrize("dilation", [0, 1, 2])
def test_energy_lies_between_0_and_full_and_on_its_side_of_the_directions(dilation: int) -> None:
    level = edge_energy(step(40.0), WINDOW, dilation=dilation)
    upright = edge_energy(step(40.0).T, WINDOW[::-1], dilation=dilation)
    assert level.level.dtype == np.uint8
    assert 0.9 * FULL < level.level.max() <= FULL
    assert level.upright.max() == 0
    np.testing.assert_allclose(upright.upright, level.level.T, atol=1)
    assert upright.level.max() == 0


def test_dilation_widens_an_edge_across_and_not_along() -> None:
    part = np.full((80, 120), 60, np.uint8)
    part[:40, 40:80] = 180
    thin, wide = (edge_energy(part, WINDOW, dilation=d) for d in (0, 2))
    grown = (wide.level[:, 60] > 0.2 * FULL).sum() - (thin.level[:, 60] > 0.2 * FULL).sum()
    assert grown == 4
    np.testing.assert_array_equal(wide.level[39] > 0.2 * FULL, thin.level[37:44].max(axis=0) > 0.2 * FULL)


@pytest.mark.parametrize("gain", [0.5, 0.75])
def test_energy_hardly_depends_on_the_light(gain: float) -> None:
    image = patchwork(0)
    bright = edge_energy(image, WINDOW)
    dark = edge_energy((image * gain).astype(np.uint8), WINDOW)
    assert cv2.absdiff(bright.level, dark.level).mean() < 0.1 * bright.level.mean()
    assert cv2.absdiff(bright.upright, dark.upright).mean() < 0.1 * bright.upright.mean()


def test_a_weak_edge_alone_has_energy_and_a_plain_image_none_and_noise_little() -> None:
    weak, strong = edge_energy(step(40.0, 90, 110), WINDOW), edge_energy(step(40.0, 20, 230), WINDOW)
    assert weak.level.max() > 0.9 * strong.level.max()
    plain = np.full((80, 120), 128, np.uint8)
    assert edge_energy(plain, WINDOW).level.max() == 0
    noisy = plain + np.random.default_rng(0).integers(0, 2, plain.shape, dtype=np.uint8)
    assert edge_energy(noisy, WINDOW, dilation=0).level.mean() < 0.15 * FULL


def test_channels_add_up_and_smoothing_takes_noise_away_and_keeps_the_shape() -> None:
    clear = patchwork(1)
    noisy = np.clip(clear + np.random.default_rng(0).normal(0.0, 10.0, clear.shape), 0, 255).astype(np.uint8)
    smooth = smoothed(noisy, 0.004)
    assert smooth.shape == clear.shape
    assert smooth.dtype == np.uint8
    flat = np.s_[13:17, 13:17]  # the middle of a patch
    before, after = (np.abs(image[flat].astype(int) - clear[flat]).mean() for image in (noisy, smooth))
    assert after < 0.7 * before
    channels = np.random.default_rng(0).uniform(0.0, 9.0, (6, 5, 3)).astype(np.float32)
    np.testing.assert_allclose(channel_sum(channels), channels.sum(axis=2), rtol=1e-6)


# Contrast of the openings.

GRID = PlaneGrid.spanning(-0.66, 0.66, -0.06, 0.21, 0.004)
STRAIGHT = np.array([0.0, 0.0, 3.0])


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
def test_openings_unlike_the_blocks_stand_out(model: PalletModel, levels: tuple[float, ...], draw_face: Draw) -> None:
    assert face_contrast(noisy(draw_face(model, GRID, STRAIGHT, levels=levels)), model) > 5.0


def test_no_openings_one_aside_or_uneven_blocks_weaken_the_contrast(epal: PalletModel, draw_face: Draw) -> None:
    board = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 150.0, 150.0)), 12.0)
    assert face_contrast(board, epal) < 1.5
    right = noisy(draw_face(epal, GRID, STRAIGHT))
    aside = noisy(draw_face(epal, GRID, STRAIGHT, (0.26, 0.0)))
    assert face_contrast(aside, epal) < 0.4 * face_contrast(right, epal)
    view = noisy(draw_face(epal, GRID, STRAIGHT))
    ramp = np.linspace(-60.0, 60.0, GRID.columns)
    uneven = replace(view, image=np.clip(view.image + ramp, 0, 255).astype(np.uint8))
    assert face_contrast(uneven, epal) < 0.5 * face_contrast(view, epal)


def test_the_less_clear_opening_counts_and_colour_tells_more_than_gray(epal: PalletModel, draw_face: Draw) -> None:
    view = noisy(draw_face(epal, GRID, STRAIGHT))
    half = view.image.copy()
    half[:, GRID.columns // 2 :] = noisy(draw_face(epal, GRID, STRAIGHT, levels=(90.0, 180.0, 180.0))).image[
        :, GRID.columns // 2 :
    ]
    assert face_contrast(replace(view, image=half), epal) < 1.5
    assert face_contrast(replace(view, image=half[:, ::-1]), epal) < 1.5
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
    assert contrast_at(np.full((GRID.rows, GRID.columns), 77, np.uint8), GRID, epal) == 0.0


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

WHOLE = (-9.0, 9.0)


@pytest.fixture
def patch(portrait: Portrait, epal: PalletModel) -> FacePatch:
    found = view_patch(portrait(epal, POSE), POSE, (-0.9, 0.9, -0.15, 0.3), 0.005)
    assert isinstance(found, FacePatch)
    return found


def test_openings_are_compared_with_their_blocks_and_aside_all_is_lost(patch: FacePatch, epal: PalletModel) -> None:
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
    pitch = epal.openings[1].center - epal.openings[0].center
    assert least_contrast(patch, epal, moved(POSE, pitch / 2)) < 0.5 * least_contrast(patch, epal, POSE)


def test_what_is_hidden_or_beyond_the_view_does_not_count(patch: FacePatch, epal: PalletModel) -> None:
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
    assert least_contrast(patch, epal, POSE, [WHOLE]) == 0.0
    assert least_contrast(patch, epal, POSE, (), [WHOLE]) == least_contrast(patch, epal, POSE)
    assert np.isnan(least_contrast(patch, epal, replace(POSE, x=POSE.x + 3.0)))
    assert np.isnan(opening_contrasts(patch, epal, replace(POSE, z=1.0))).all()
