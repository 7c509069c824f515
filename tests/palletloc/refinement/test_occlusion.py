from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, Mounting, Opening, PalletModel, Shot
from palletloc.cameras import Pinhole
from palletloc.edge_fit import EdgeFit, EdgePeaks
from palletloc.face import EdgeKind, FaceEdge, face_lines
from palletloc.geometry import FloatArray
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement import occlusion
from palletloc.refinement.occlusion import (
    explained_part,
    hidden_part,
    hidden_spans,
    is_hidden,
    joined,
    visible_occluders,
)
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.refinement.profiles import FaceCuts, face_cuts
from tests.palletloc.poses import Paints

OPENINGS = tuple(Opening(center, 0.022, 0.3825, 0.1) for center in (-0.26375, 0.26375))
MODEL = PalletModel("two_openings", 1.2, 0.144, 0.8, OPENINGS)
HALF = MODEL.width / 2
BIN = MODEL.width / occlusion.BINS
LINE = EdgeFit(0.0, 0.0, 1e-4, 1e-4, 1.0, 10.0)
TOLERANCE = 0.003
KINDS = (EdgeKind.TOP, EdgeKind.BOTTOM, EdgeKind.OPENING_TOP, EdgeKind.OPENING_BOTTOM)
REACHED = 1.5 * BIN
"""How well the ends of a hidden stretch are found: its bin, and half of a neighbour that has more lines."""
LOST = ["nothing", "beside", "fainter", "stronger"]
Spans = tuple[tuple[float, float], ...]


@dataclass
class Face:
    """Peaks that lie on all lines, until some are taken away."""

    cuts: FaceCuts
    offset: FloatArray
    strength: FloatArray
    fits: list[EdgeFit | None]

    @staticmethod
    def drawn() -> "Face":
        cuts = face_cuts(MODEL, 0.005, 0.005, False)
        strength = cuts.by_line(np.full(len(cuts.along), LINE.strength), -1.0)
        return Face(cuts, np.zeros_like(strength), strength, [LINE] * len(cuts.lines))

    def rows(self, kinds: Sequence[EdgeKind]) -> list[int]:
        return [row for row, line in enumerate(self.cuts.lines) if line.kind in kinds]

    def lose(self, left: float, right: float, kinds: Sequence[EdgeKind] = KINDS, instead: str = "nothing") -> None:
        """Take the peaks of a stretch away, or put other ones there."""
        along = self.cuts.by_line(self.cuts.along, np.inf)
        for row in self.rows(kinds):
            place = along[row] + self.cuts.lines[row].whole.middle[0]
            lost = (place > left) & (place < right) & (self.strength[row] >= 0)
            if instead == "beside":
                self.offset[row, lost] = 2 * TOLERANCE
            else:
                self.strength[row, lost] *= {"nothing": 0.0, "fainter": 0.2, "stronger": 5.0}[instead]

    def hidden(self) -> Spans:
        peaks = EdgePeaks(self.cuts.by_line(self.cuts.along, 0.0), self.offset, self.strength)
        return hidden_spans(self.cuts, peaks, self.fits, np.full(len(self.fits), TOLERANCE))


@st.composite
def separate(draw: st.DrawFn) -> Spans:
    """Draw stretches of the face that do not touch, from left to right."""
    ends = sorted(draw(st.lists(st.integers(-60, 60), min_size=2, max_size=8, unique=True)))
    return tuple((0.01 * low, 0.01 * high) for low, high in zip(ends[::2], ends[1::2], strict=False))


def test_seen_lines_lost_uprights_and_a_dent_hide_nothing() -> None:
    assert Face.drawn().hidden() == ()
    face = Face.drawn()
    face.lose(-HALF, HALF, [EdgeKind.SIDE, EdgeKind.OPENING_SIDE])
    assert face.hidden() == ()
    face = Face.drawn()
    face.lose(-0.4 * BIN, 0.4 * BIN)
    assert face.hidden() == ()


@pytest.mark.parametrize("instead", LOST)
@settings(max_examples=25, deadline=None)
@given(st.floats(-HALF, HALF - 4 * BIN), st.floats(4 * BIN, 0.5))
def test_a_stretch_where_all_lines_are_lost_is_found(instead: str, left: float, width: float) -> None:
    face = Face.drawn()
    right = min(left + width, HALF)
    face.lose(left, right, instead=instead)
    found = face.hidden()
    assert len(found) == 1
    assert found[0] == pytest.approx((left, right), abs=REACHED)


@pytest.mark.parametrize("shown", [0.35, 0.5])
def test_in_noise_fewer_cuts_show_what_nothing_hides(shown: float) -> None:
    face, ends = Face.drawn(), (-0.4, -0.1)
    noise = np.random.default_rng(0).random(face.strength.shape) > shown
    face.strength[noise & (face.strength > 0)] = 0.0
    assert face.hidden() == ()
    face.lose(*ends)
    (found,) = face.hidden()
    assert found == pytest.approx(ends, abs=REACHED)


def test_two_stretches_are_told_apart() -> None:
    face, lost = Face.drawn(), [(-0.4, -0.2), (0.15, 0.4)]
    for left, right in lost:
        face.lose(left, right)
    found = face.hidden()
    assert len(found) == 2
    np.testing.assert_allclose(found, lost, atol=REACHED)


@settings(max_examples=50, deadline=None)
@given(separate())
def test_stretches_ascend_and_lie_inside_the_face(lost: Spans) -> None:
    face = Face.drawn()
    for left, right in lost:
        face.lose(left, right)
    ends = np.array([-HALF, *(end for span in face.hidden() for end in span), HALF])
    assert (np.diff(ends) >= -1e-9).all()
    assert (np.diff(ends)[1::2] > (occlusion.LEAST_WIDTH - 0.01) * BIN).all()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, deadline=None)
@given(separate())
def test_one_line_that_is_missing_hides_nothing(kind: EdgeKind, lost: Spans) -> None:
    face = Face.drawn()
    for left, right in lost:
        face.lose(left, right, [kind])
    assert face.hidden() == ()


@pytest.mark.parametrize("kind", KINDS)
def test_a_line_that_is_nowhere_seen_has_no_vote(kind: EdgeKind) -> None:
    face = Face.drawn()
    face.lose(-HALF, HALF, [kind])
    face.fits = [None if row in face.rows([kind]) else LINE for row in range(len(face.fits))]
    assert face.hidden() == ()
    left, right = OPENINGS[0].left, OPENINGS[0].right
    face.lose(left, right)
    found = face.hidden()
    assert len(found) == 1
    assert hidden_part(left, right, found) > 0.7
    assert found[0][0] > left - 2 * BIN
    assert found[0][1] < right + 2 * BIN


def test_a_line_alone_cannot_tell() -> None:
    for kind in KINDS:
        face = Face.drawn()
        face.lose(-0.3, 0.3)
        face.fits = [LINE if row in face.rows([kind]) else None for row in range(len(face.fits))]
        assert face.hidden() == ()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_line_alone_widens_what_others_say(side: float) -> None:
    face = Face.drawn()
    ends = (0.25, HALF) if side > 0 else (-HALF, -0.25)
    face.lose(*ends)
    top = set(face.rows([EdgeKind.TOP]))
    face.fits = [None if row in top else fit for row, fit in enumerate(face.fits)]
    (found,) = face.hidden()
    np.testing.assert_allclose(found, ends, atol=2 * BIN)
    assert side * HALF == pytest.approx(found[int(side > 0)])
    face = Face.drawn()
    face.fits = [None if row in top else fit for row, fit in enumerate(face.fits)]
    face.lose(side * HALF - 0.08 * (side > 0), side * HALF + 0.08 * (side < 0))
    assert face.hidden() == ()


def test_peaks_are_counted_along_the_measured_line_and_not_the_drawn_one() -> None:
    face = Face.drawn()
    slope, offset = 0.02, 0.02
    face.offset[:] = offset + slope * face.cuts.by_line(face.cuts.along, 0.0)
    assert hidden_part(-HALF, HALF, face.hidden()) > 0.9
    face.fits = [EdgeFit(offset, slope, 1e-4, 1e-4, 1.0, LINE.strength)] * len(face.fits)
    assert face.hidden() == ()


@given(separate(), st.floats(-HALF, HALF), st.floats(0.001, HALF))
def test_the_hidden_part_is_a_part_and_adds_up(spans: Spans, left: float, width: float) -> None:
    right = left + width
    whole = hidden_part(left, right, spans)
    assert 0.0 <= whole <= 1.0
    middle = left + 0.3 * width
    parts = 0.3 * hidden_part(left, middle, spans) + 0.7 * hidden_part(middle, right, spans)
    assert parts == pytest.approx(whole, abs=1e-6)
    assert sum(hidden_part(left, right, [span]) for span in spans) == pytest.approx(whole, abs=1e-9)


@given(separate())
def test_a_stretch_is_wholly_hidden_by_itself_and_not_at_all_by_nothing(spans: Spans) -> None:
    for left, right in spans:
        assert hidden_part(left, right, spans) == pytest.approx(1.0)
        assert hidden_part(left, right, ()) == 0.0
        assert hidden_part(left, left, spans) == 1.0
    assert hidden_part(2 * HALF, 3 * HALF, spans) == 0.0
    assert hidden_part(2 * HALF, 2 * HALF, spans) == 0.0


@given(separate())
def test_an_edge_is_hidden_where_most_of_it_is(spans: Spans) -> None:
    for line in face_lines(MODEL):
        edge: FaceEdge = line.whole
        part = hidden_part(edge.start[0], edge.end[0], spans)
        assert is_hidden(edge, spans) is (part > occlusion.MOSTLY)
        if not edge.horizontal:
            assert is_hidden(edge, spans) is any(low <= edge.start[0] <= high for low, high in spans)


Stretch = tuple[float, float]
ends = st.tuples(st.integers(0, 40), st.integers(1, 10))
stretches = st.lists(ends.map(lambda end: (float(end[0]), float(end[0] + end[1]))))


@given(stretches, stretches)
def test_joined_stretches_cover_the_same_once(first: list[Stretch], second: list[Stretch]) -> None:
    found = joined(first, second)
    places = np.arange(0.25, 51.0, 0.5)

    def covered(spans: Sequence[Stretch]) -> list[bool]:
        return [any(low < place < high for low, high in spans) for place in places]

    assert covered(found) == covered([*first, *second])
    assert all(left[1] < right[0] for left, right in pairwise(found))
    assert joined(found) == found


# What is seen to stand before a face.

CAMERA = Pinhole(640, 480, 380.0, 380.0, 319.5, 239.5)
MOUNTED = RigidTransform.from_components([0.3, -0.1, 1.0], Rotation.from_euler("ZYX", [1.2, 0.25, 0.02]))
POSE = LevelPose(0.9, 2.2, 0.3, 1.4)
FACE, FLOOR, GRAIN = 170.0, 90.0, 6.0


def seen(paint_plane: Paints, before: dict[tuple[float, float, float], float], aside: float = 0.0) -> FacePatch:
    """Return a view of a face 1.2 m wide with things before it: (left, right, lowest) and their gray."""

    def paint(points: FloatArray) -> FloatArray:
        right, up = points[..., 0], points[..., 1]
        gray = np.where((np.abs(right - aside) < 0.6) & (up > 0) & (up < 0.144), FACE, FLOOR)
        for (left, end, low), colour in before.items():
            gray = np.where((right > left) & (right < end) & (up > low), colour, gray)
        return gray

    camera_from_plane = (MOUNTED.inv() * POSE.transform() * PALLET_FROM_VERTICAL).as_matrix()
    image = paint_plane(CAMERA, camera_from_plane, (-1.3, 1.3, -0.2, 0.3), paint)
    noisy = np.clip(np.rint(image + np.random.default_rng(3).normal(0.0, GRAIN, image.shape)), 0, 255)
    shot = Shot(noisy.astype(np.uint8), CAMERA, Mounting(MOUNTED))
    patch = view_patch(shot, POSE, (-0.75, 0.75, -0.1, 0.25), 0.006)
    assert isinstance(patch, FacePatch)
    return patch


@pytest.mark.parametrize("gray", [20.0, 160.0, 230.0])
@pytest.mark.parametrize(("left", "right"), [(-0.6, -0.35), (-0.1, 0.1), (0.2, 0.6)])
def test_a_post_that_reaches_below_the_face_is_seen(
    paint_plane: Paints, epal: PalletModel, left: float, right: float, gray: float
) -> None:
    patch = seen(paint_plane, {(left, right, -1.0): gray})
    assert explained_part(patch, epal, POSE, [(left, right)]) == pytest.approx((right - left) / epal.width)


def test_what_is_only_on_the_face_or_only_below_or_floor_is_no_post(paint_plane: Paints, epal: PalletModel) -> None:
    beside = seen(paint_plane, {}, aside=0.5)  # the real face stands half a metre aside: floor is where it should be
    assert explained_part(beside, epal, POSE, [(-0.6, -0.1)]) == 0.0
    above = seen(paint_plane, {(0.1, 0.4, 0.02): 20.0})
    assert explained_part(above, epal, POSE, [(0.1, 0.4)]) == 0.0
    label = seen(paint_plane, {(-0.2, 0.1, 0.02): 20.0})
    assert visible_occluders(label, epal, POSE) == ()
    line = seen(paint_plane, {(-0.2, 0.1, -1.0): 20.0, (-0.25, 0.15, 0.0): FACE})
    assert visible_occluders(line, epal, POSE) == ()
    assert visible_occluders(label, epal, LevelPose(POSE.x, POSE.y, POSE.z - 0.3, POSE.yaw)) == ()


def test_each_hidden_stretch_is_judged_by_itself_and_none_or_all_explain_nothing(
    paint_plane: Paints, epal: PalletModel
) -> None:
    patch = seen(paint_plane, {(-0.4, -0.2, -1.0): 230.0})
    found = explained_part(patch, epal, POSE, [(-0.4, -0.2), (0.3, 0.6)])
    assert found == pytest.approx(0.2 / epal.width)
    assert explained_part(patch, epal, POSE, []) == 0.0
    assert explained_part(patch, epal, POSE, [(-0.6, 0.6)]) == 0.0
    lifted = LevelPose(POSE.x, POSE.y, POSE.z - 0.3, POSE.yaw)  # what is below the face is out of the view
    assert explained_part(patch, epal, lifted, [(-0.4, -0.2)]) == 0.0


@pytest.mark.parametrize("gray", [20.0, 230.0])
@pytest.mark.parametrize(("left", "right"), [(-0.6, -0.5), (0.3, 0.36), (0.5, 0.6)])
def test_a_post_before_a_face_is_seen_where_it_stands(
    paint_plane: Paints, epal: PalletModel, left: float, right: float, gray: float
) -> None:
    ((low, high),) = visible_occluders(seen(paint_plane, {(left, right, -1.0): gray}), epal, POSE)
    assert low == pytest.approx(left, abs=0.025)
    assert high == pytest.approx(right, abs=0.025)
