import itertools
from collections.abc import Callable
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import Mounting, Opening, PalletModel, Shot
from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.face import face_lines
from palletloc.geometry import BoolArray, FloatArray, Image
from palletloc.pallet_library import load_library
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.projection import pixel_sizes
from palletloc.refinement.profiles import FEWEST_CUTS, MOST_CUTS, FaceCuts, Profiles, cut_profiles, face_cuts
from tests.palletloc.poses import Shoots

BOX = PalletModel("box", 1.0, 0.4, 1.0, (Opening(-0.2, 0.1, 0.2, 0.2), Opening(0.2, 0.1, 0.2, 0.2)))
REACH = 0.03


def lens(cx: float) -> KannalaBrandt:
    return KannalaBrandt(1200, 600, 175.0, 176.0, cx, 301.0, k1=0.03, k2=-0.012, max_angle=np.radians(96.0))


DUAL = DualFisheye(
    FisheyeLens(lens(298.0), RigidTransform.from_components([0.012, 0, 0], Rotation.from_rotvec([0.01, -0.02, 0]))),
    FisheyeLens(lens(902.0), RigidTransform.from_components([-0.012, 0, 0], Rotation.from_euler("z", 3.13))),
)
SPHERE = Equirectangular(1200, 600)
VIEWS: dict[str, tuple[CameraModel, float]] = {
    "equirectangular": (SPHERE, 0.5),
    "across_the_seam": (SPHERE, 180.0),
    "beside_the_seam": (SPHERE, -179.0),
    "pinhole": (Pinhole(640, 400, 320.0, 318.0, 322.0, 199.0), 4.0),
    "distorted": (Pinhole(640, 400, 330.0, 330.0, 317.0, 204.0, k1=-0.2, k2=0.05, p1=0.002), -3.0),
    "fisheye": (KannalaBrandt(700, 500, 240.0, 241.0, 349.0, 251.0, k1=0.02, max_angle=1.7), 20.0),
    "dual_fisheye": (DUAL, 25.0),
    "dual_fisheye_back": (DUAL, 165.0),
}
"""A camera, and the direction in which it sees the face, in degrees."""


def facing(direction_deg: float, distance: float = 1.6) -> FloatArray:
    """The plane of a face that stands in a direction, seen from a little above and aside."""
    turned = RigidTransform.from_rotation(Rotation.from_euler("z", direction_deg, degrees=True))
    tilted = RigidTransform.from_components([distance, 0.05, -0.45], Rotation.from_euler("ZYX", [0.12, -0.05, 0.02]))
    return np.asarray((turned * tilted * PALLET_FROM_VERTICAL).as_matrix())


class Read(NamedTuple):
    """Profiles across a face, and what they were read with."""

    cuts: FaceCuts
    profiles: Profiles
    pixel: FloatArray
    """(lines, 2) pixel sizes across and along."""

    def peaks(self) -> FloatArray:
        """Where each cut's gradient peaks, in metres."""
        gradient, offsets = self.profiles.gradient(1.0).astype(float), self.profiles.offsets
        best = np.clip(gradient[:, 1:-1].argmax(axis=1) + 1, 1, len(offsets) - 2)
        a, b, c = (gradient[np.arange(len(best)), best + k] for k in (-1, 0, 1))
        step = offsets[1] - offsets[0]
        return np.asarray((offsets[best] + 0.5 * (a - c) / np.minimum(a - 2 * b + c, -1e-9) * step) * REACH)

    def well_inside(self) -> BoolArray:
        """Which cuts are none of the pads and farther from the end of their stretch than smoothing goes."""
        inner = np.zeros(len(self.cuts.line), bool)
        inner[self.cuts.inner] = True
        return np.asarray(inner & (self.cuts.end > 3 * self.pixel[self.cuts.line, 1]))


def shot_of(camera: CameraModel, image: Image) -> Shot:
    return Shot(image, camera, Mounting(RigidTransform.identity()))


def read(camera: CameraModel, image: Image, camera_from_face: FloatArray, model: PalletModel = BOX) -> Read:
    middle = np.array([[0.0, model.height / 2]] * 2)
    right, up = pixel_sizes(camera, RigidTransform.from_matrix(camera_from_face), middle, np.eye(2))
    cuts = face_cuts(model, float(right), float(up), False)
    pixel = np.where(cuts.level[:, None], [[up, right]], [[right, up]])
    zero, reach = np.zeros(len(cuts.lines)), np.full(len(cuts.lines), REACH)
    return Read(cuts, cut_profiles(shot_of(camera, image), camera_from_face, cuts, zero, reach, pixel), pixel)


@pytest.mark.parametrize(("view", "grown"), list(zip(VIEWS, itertools.cycle([0.0061, -0.0043]), strict=False)))
def test_an_edge_is_found_where_it_is_drawn_through_every_camera(view: str, grown: float, shoot_face: Shoots) -> None:
    camera, direction = VIEWS[view]
    camera_from_face = facing(direction)
    done = read(camera, shoot_face(camera, camera_from_face, BOX, grown), camera_from_face)
    assert done.profiles.valid.all()
    inside = done.well_inside()
    assert inside.sum() > 0.6 * len(done.cuts.inner)
    wrong = (done.peaks() - grown) / done.pixel[done.cuts.line, 0]
    by_line = [np.median(wrong[inside & (done.cuts.line == line)]) for line in range(len(done.cuts.lines))]
    assert np.abs(by_line).max() < 0.2
    assert np.sqrt(np.mean(np.square(by_line))) < 0.08
    assert np.percentile(np.abs(wrong[inside]), 95) < 0.22


@pytest.mark.parametrize("at_the_seam", [-0.5, -0.1, 0.0, 0.3, 0.5])
def test_the_seam_changes_nothing_wherever_it_is(at_the_seam: float, shoot_face: Shoots) -> None:
    plane = facing(0.0)
    image = shoot_face(SPHERE, plane, BOX)
    straight = read(SPHERE, image, plane).profiles
    column = SPHERE.project(np.array([at_the_seam, 0.2]) @ plane[:3, :2].T + plane[:3, 3]).pixels[0]
    for columns in range(SPHERE.width - round(column) - 2, SPHERE.width - round(column) + 3):
        turned = facing(-360.0 * columns / SPHERE.width)
        rolled = read(SPHERE, np.roll(image, columns, axis=1), turned).profiles
        np.testing.assert_allclose(rolled.gradient(1.0), straight.gradient(1.0), atol=0.3)


def test_colour_gray_and_the_negative_have_the_same_profiles(shoot_face: Shoots) -> None:
    camera, direction = VIEWS["pinhole"]
    plane = facing(direction)
    image = shoot_face(camera, plane, BOX)
    gray = read(camera, image, plane).profiles.gradient(1.0)
    three = read(camera, np.repeat(image[..., None], 3, axis=2), plane).profiles.gradient(1.0)
    np.testing.assert_allclose(three, np.sqrt(3.0) * gray, rtol=1e-3, atol=1e-3)
    for channel in range(3):
        only = np.full((*image.shape, 3), 128, np.uint8)
        only[..., channel] = image
        np.testing.assert_allclose(read(camera, only, plane).profiles.gradient(1.0), gray, rtol=1e-3, atol=1e-3)
    camera, direction = VIEWS["fisheye"]
    plane = facing(direction)
    image = shoot_face(camera, plane, BOX)
    here, other = (read(camera, picture, plane).profiles.gradient(1.0) for picture in (image, 255 - image))
    np.testing.assert_allclose(here, other, atol=1e-3)


def test_a_shift_moves_the_cuts_with_it(shoot_face: Shoots) -> None:
    camera, direction = VIEWS["pinhole"]
    plane = facing(direction)
    image = shoot_face(camera, plane, BOX)
    done = read(camera, image, plane)
    shift = np.where(done.cuts.level, 0.004, -0.007)
    reach = np.full(len(shift), REACH)
    moved = done._replace(profiles=cut_profiles(shot_of(camera, image), plane, done.cuts, shift, reach, done.pixel))
    inside = done.well_inside()
    wrong = moved.peaks() + shift[done.cuts.line] - done.peaks()
    assert np.median(np.abs(wrong[inside]) / done.pixel[done.cuts.line[inside], 0]) < 0.05


def test_profiles_reach_beyond_both_sides_and_are_flat_in_a_plain_image(shoot_face: Shoots) -> None:
    camera, direction = VIEWS["distorted"]
    plain = np.full((camera.height, camera.width, 3), 77, np.uint8)
    profiles = read(camera, plain, facing(direction)).profiles
    assert profiles.valid.all()
    assert np.abs(profiles.gradient(1.0)).max() < 1e-3
    camera, direction = VIEWS["pinhole"]
    done = read(camera, shoot_face(camera, facing(direction), BOX), facing(direction))
    offsets = done.profiles.offsets
    np.testing.assert_allclose(offsets, -offsets[::-1])
    np.testing.assert_allclose(np.diff(offsets), offsets[1] - offsets[0])
    assert offsets[-1] > 1.0
    assert np.isclose(offsets, 1.0).any()
    assert done.profiles.gradient(1.0).shape == (len(done.cuts.line), len(offsets))
    assert (offsets[1] - offsets[0]) * REACH < done.pixel.min()


@pytest.mark.parametrize("direction", [38.0, -40.0])
def test_cuts_beyond_the_image_are_told_from_those_in_it(direction: float, shoot_face: Shoots) -> None:
    camera = VIEWS["pinhole"][0]
    plane = facing(direction)
    done = read(camera, shoot_face(camera, facing(0.0), BOX), facing(0.0))
    cut = cut_profiles(
        shot_of(camera, np.zeros((camera.height, camera.width), np.uint8)),
        plane,
        done.cuts,
        np.zeros(len(done.cuts.lines)),
        np.full(len(done.cuts.lines), REACH),
        done.pixel,
    )
    outward = REACH * done.cuts.outward
    ends = [done.cuts.points + part * outward for part in (0.0, 1.0)]
    seen = [camera.project(points @ plane[:3, :2].T + plane[:3, 3]).valid for points in ends]
    np.testing.assert_array_equal(cut.valid, seen[0] & seen[1])
    assert 0.1 < cut.valid.mean() < 0.9
    assert np.isfinite(cut.gradient(1.0)).all()


def test_what_lies_on_one_stretch_of_a_line_does_not_reach_the_next(shoot_face: Shoots) -> None:
    camera, direction = VIEWS["pinhole"]
    plane = facing(direction)
    whole = shoot_face(camera, plane, BOX)
    half = shoot_face(camera, plane, replace(BOX, openings=BOX.openings[:1]))
    here, other = (read(camera, image, plane) for image in (whole, half))
    mine = np.intersect1d(np.flatnonzero(here.cuts.points[:, 0] < -0.05), here.cuts.inner)
    opened = [i for i, line in enumerate(here.cuts.lines) if line.kind.startswith("opening")]
    mine = mine[np.isin(here.cuts.line[mine], opened)]
    assert len(mine) > 20
    np.testing.assert_allclose(here.profiles.gradient(1.0)[mine], other.profiles.gradient(1.0)[mine], atol=0.2)
    right = np.intersect1d(np.flatnonzero(here.cuts.points[:, 0] > 0.05), here.cuts.inner)
    assert np.abs(here.profiles.gradient(1.0)[right] - other.profiles.gradient(1.0)[right]).max() > 10.0


# Where to cut.

LEVEL, UPRIGHT = 0.006, 0.005


def cuts_of(model: PalletModel, without_bottom: bool = False) -> FaceCuts:
    return face_cuts(model, LEVEL, UPRIGHT, without_bottom)


def test_every_stretch_of_every_line_is_covered_evenly_from_end_to_end(model: PalletModel) -> None:
    cuts = cuts_of(model)
    assert set(cuts.lines) == set(face_lines(model))
    assert len(cuts.lines) == len(face_lines(model))
    assert (np.diff(cuts.level.astype(int)) <= 0).all()
    ranges = [np.arange(len(cuts.line))[kind.cuts] for kind in cuts.kinds]
    np.testing.assert_array_equal(np.concatenate(ranges), np.arange(len(cuts.line)))
    for kind, there in zip(cuts.kinds, ranges, strict=True):
        assert set(cuts.line[there]) == set(np.arange(len(cuts.lines))[kind.lines])
        assert len(set(cuts.level[kind.lines])) == 1
    counted = 0
    for number, line in enumerate(cuts.lines):
        inner = cuts.inner[cuts.line[cuts.inner] == number]
        spacing = LEVEL if line.whole.horizontal else UPRIGHT
        for edge in line.edges:
            start, end = np.array(edge.start), np.array(edge.end)
            way = (end - start) / edge.length
            along = (cuts.points[inner] - start) @ way
            mine = inner[(along > -1e-9) & (along < edge.length + 1e-9)]
            place = (cuts.points[mine] - start) @ way
            np.testing.assert_allclose(cuts.points[mine], start + place[:, None] * way, atol=1e-12)
            apart = edge.length / len(mine)
            np.testing.assert_allclose(np.diff(place), apart, atol=1e-12)
            assert place[0] == pytest.approx(apart / 2)
            assert edge.length - place[-1] == pytest.approx(apart / 2)
            assert len(mine) in (FEWEST_CUTS, MOST_CUTS) or apart == pytest.approx(spacing, abs=0.5 * apart / 7)
            np.testing.assert_allclose(cuts.end[mine], np.minimum(place, edge.length - place), atol=1e-12)
            counted += len(mine)
    assert counted == len(cuts.inner)


def test_positions_count_from_the_middle_of_the_whole_line(model: PalletModel) -> None:
    cuts = cuts_of(model)
    for number, line in enumerate(cuts.lines):
        mine = cuts.line == number
        way = np.array([1.0, 0.0] if line.whole.horizontal else [0.0, 1.0])
        expected = (cuts.points[mine] - np.array(line.whole.middle)) @ way
        np.testing.assert_allclose(cuts.along[mine], expected, atol=1e-12)
        assert cuts.level[number] == line.whole.horizontal
        np.testing.assert_array_equal(cuts.outward[mine], np.tile(line.whole.outward, (mine.sum(), 1)))


def test_pads_never_count(model: PalletModel) -> None:
    cuts = cuts_of(model)
    pads = np.setdiff1d(np.arange(len(cuts.line)), cuts.inner)
    assert len(pads) > 0
    assert (cuts.end[pads] < 0).all()
    assert (cuts.end[cuts.inner] > 0).all()
    values = np.full(len(cuts.line), np.inf)
    values[cuts.inner] = np.arange(len(cuts.inner))
    table = cuts.by_line(values, -1.0)
    assert table.shape == (len(cuts.lines), cuts.count)
    assert np.isfinite(table).all()
    np.testing.assert_array_equal(np.sort(table[table >= 0]), np.arange(len(cuts.inner)))


def test_each_row_of_a_table_is_a_line_in_order_and_filled_up_at_its_end(model: PalletModel) -> None:
    cuts = cuts_of(model)
    along = cuts.by_line(cuts.along, np.nan)
    np.testing.assert_array_equal(cuts.in_line, np.nan_to_num(along))
    for number, row in enumerate(along):
        there = row[np.isfinite(row)]
        assert len(there) == (cuts.line[cuts.inner] == number).sum()
        assert np.isfinite(row[: len(there)]).all()
        assert (np.diff(there) > 0).all()
    assert np.isfinite(along).all(axis=1).any()


def test_the_spacing_is_length_over_cuts_and_without_the_lower_edge_all_else_stays(model: PalletModel) -> None:
    cuts = cuts_of(model)
    counts = np.bincount(cuts.line[cuts.inner])
    spacing = np.array([sum(edge.length for edge in line.edges) for line in cuts.lines]) / counts
    for kind in cuts.kinds:
        assert kind.spacing == pytest.approx(spacing[kind.lines].mean())
    whole, above = cuts_of(model), cuts_of(model, without_bottom=True)
    assert above.lines == tuple(line for line in whole.lines if line.kind != "bottom")
    kept = np.array([line.kind != "bottom" for line in whole.lines])[whole.line]
    np.testing.assert_array_equal(above.points, whole.points[kept])


@pytest.mark.parametrize(
    "law",
    [
        test_every_stretch_of_every_line_is_covered_evenly_from_end_to_end,
        test_positions_count_from_the_middle_of_the_whole_line,
        test_pads_never_count,
        test_each_row_of_a_table_is_a_line_in_order_and_filled_up_at_its_end,
        test_the_spacing_is_length_over_cuts_and_without_the_lower_edge_all_else_stays,
    ],
)
def test_it_holds_for_every_pallet_of_the_library(law: Callable[[PalletModel], None]) -> None:
    for each in load_library().values():
        law(each)


def test_what_is_shared_cannot_be_written_and_each_model_has_its_cuts(t11: PalletModel, epal: PalletModel) -> None:
    cuts = cuts_of(t11)
    assert cuts_of(t11) is cuts
    arrays = [
        getattr(cuts, field.name) for field in fields(cuts) if isinstance(getattr(cuts, field.name), np.ndarray)
    ]
    assert not any(array.flags.writeable for array in arrays)
    wider = replace(t11, width=t11.width + 0.004)
    for other in (wider, epal):
        here, there = cuts_of(t11), cuts_of(other)
        assert here.points.shape != there.points.shape or not np.array_equal(here.points, there.points)
    sides = sorted(line.whole.middle[0] for line in cuts_of(wider).lines if line.kind == "side")
    np.testing.assert_allclose(sides, [-wider.width / 2, wider.width / 2])


@pytest.mark.parametrize("spacing", [1e-5, 10.0])
def test_however_far_the_camera_a_stretch_has_some_cuts_and_not_too_many(spacing: float, epal: PalletModel) -> None:
    cuts = face_cuts(epal, spacing, spacing, False)
    stretches = sum(len(line.edges) for line in cuts.lines)
    assert len(cuts.inner) == stretches * (MOST_CUTS if spacing < 1e-3 else FEWEST_CUTS)
