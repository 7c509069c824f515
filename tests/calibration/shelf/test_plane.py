import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.shelf.front_line import FrontLine, pallet_line, upright_line
from calibration.shelf.plane import Foot, PlaneEstimate, disagreement, fuse, inverse_of
from calibration.shelf.upright_edges import Edges
from palletloc.geometry import FloatArray
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import present

FOOT = Foot(np.array([1.0, -0.5]), 1.4)


def said(method: str, turn_deg: float, distance: float, sigma_deg: float, sigma: float) -> PlaneEstimate:
    information = np.diag([1 / np.radians(sigma_deg) ** 2, 1 / sigma**2])
    return PlaneEstimate(method, float(np.radians(turn_deg)), distance, information, "")


def heading_only(method: str, turn_deg: float, sigma_deg: float) -> PlaneEstimate:
    return PlaneEstimate(
        method, float(np.radians(turn_deg)), float("nan"), np.diag([1 / np.radians(sigma_deg) ** 2, 0.0]), ""
    )


@given(st.floats(-0.5, 0.5), st.floats(0.3, 5.0), st.floats(-4, 4))
def test_a_plane_is_described_the_same_by_every_point_of_it(turn: float, distance: float, aside: float) -> None:
    plane = FOOT.plane(turn, distance)
    along = plane.facing + np.pi / 2
    moved = ShelfPlane(plane.x + aside * np.cos(along), plane.y + aside * np.sin(along), plane.facing)
    assert FOOT.described(moved) == pytest.approx((turn, distance), abs=1e-9)


def test_the_plane_faces_the_foot() -> None:
    plane = FOOT.plane(0.1, 2.0)
    towards = FOOT.point - (plane.x, plane.y)
    assert towards @ (np.cos(plane.facing), np.sin(plane.facing)) == pytest.approx(2.0)


def test_equal_estimates_halve_the_variance() -> None:
    estimate = said("a", 0.2, 2.0, 0.1, 0.01)
    fused = present(fuse([estimate, said("b", 0.2, 2.0, 0.1, 0.01)]))
    assert fused.covariance == pytest.approx(inverse_of(estimate.information) / 2)
    assert (fused.turn, fused.distance) == pytest.approx((estimate.turn, estimate.distance))


def test_the_surer_method_counts_more() -> None:
    fused = present(fuse([said("a", 0.0, 2.0, 0.1, 0.01), said("b", 0.0, 2.05, 0.1, 0.02)]))
    assert fused.distance == pytest.approx(2.01)


def test_a_heading_alone_leaves_the_distance_as_it_is() -> None:
    fused = present(fuse([said("a", 0.0, 2.0, 0.2, 0.01), heading_only("b", 0.2, 0.2)]))
    assert fused.distance == pytest.approx(2.0)
    assert np.degrees(fused.turn) == pytest.approx(0.1)
    assert fused.covariance[1, 1] == pytest.approx(0.01**2)


def test_headings_alone_give_no_plane() -> None:
    assert fuse([heading_only("a", 0.0, 0.1), heading_only("b", 0.0, 0.1)]) is None


def test_what_is_common_to_all_methods_is_added_once() -> None:
    common = np.diag([1e-6, 1e-4])
    estimate = said("a", 0.0, 2.0, 0.1, 0.01)
    alone, both = fuse([estimate], common), fuse([estimate, estimate], common)
    assert alone is not None
    assert both is not None
    assert alone.covariance - common == pytest.approx(2 * (both.covariance - common))


def test_the_two_that_disagree_most_are_named() -> None:
    found = present(
        disagreement(
            [
                said("uprights", 0, 2.0, 0.1, 0.005),
                said("beams", 0, 2.03, 0.1, 0.01),
                said("pallets", 0, 2.2, 0.5, 0.03),
            ]
        )
    )
    assert (found.first, found.second) == ("uprights", "pallets")
    assert found.distance == pytest.approx(0.2)


def test_a_heading_that_disagrees_is_found() -> None:
    found = present(disagreement([said("uprights", 0, 2.0, 0.1, 0.005), heading_only("lines", 1.0, 0.2)]))
    assert np.isnan(found.distance)


def test_a_plane_that_lies_apart_says_as_much_of_the_heading() -> None:
    estimate = said("pallets", 0.3, 2.0, 0.2, 0.01)
    apart = estimate.apart(0.05)
    assert apart.sigma == pytest.approx((estimate.sigma[0], np.hypot(0.01, 0.05)))


def test_differences_are_as_rare_as_the_test_says() -> None:
    rng = np.random.default_rng(5)
    alarms, errors = 0, []
    for _ in range(2000):
        drawn = [
            said(name, float(rng.normal(0, s)), float(rng.normal(2, d)), s, d)
            for name, s, d in (("a", 0.1, 0.01), ("b", 0.3, 0.02))
        ]
        fused = present(fuse(drawn))
        alarms += fused.disagreement is not None
        off = np.array([fused.turn, fused.distance - 2.0])
        errors.append(off @ np.linalg.solve(fused.covariance, off))
    assert alarms <= 15  # 5.4 expected
    assert np.mean(errors) == pytest.approx(2.0, rel=0.1)


HERE = Foot(np.zeros(2), np.pi / 2)  # along x to the right, into the shelf along y
KNOWN, ROUGH = float(np.radians(1.2)), float(np.radians(6.0))


def posts(turn: float, distance: float, places: tuple[float, ...], votes: float = 0.9) -> Edges:
    """Return front and rear corners of posts 0.1 m wide and 0.07 m deep."""
    cos, sin = np.cos(turn), np.sin(turn)
    corners = [
        (cos * a - sin * (distance + d), sin * a + cos * (distance + d))
        for place in places
        for a in (place, place + 0.1)
        for d in (0.0, 0.07)
    ]
    return Edges(np.array(corners), np.full(len(corners), votes), np.ones(len(corners)))


def joined(*parts: Edges) -> Edges:
    return Edges(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("places", "vote", "side")))


def noise(edges: Edges, sigma: float = 0.002) -> FloatArray:
    return np.eye(2 * len(edges.vote)) * sigma**2


def front(edges: Edges, heading_sigma: float = KNOWN) -> FrontLine:
    return present(upright_line(edges, edges.places, noise(edges), HERE, heading_sigma))


@pytest.mark.parametrize("turn_deg", [-1.5, 0.0, 0.8])
def test_the_front_corners_are_found_before_the_rear_ones(turn_deg: float) -> None:
    edges = posts(float(np.radians(turn_deg)), 1.8, (-2.0, 0.7))
    line = front(edges)
    assert line.members.tolist() == [True, False, True, False] * 2
    assert np.degrees(line.estimate.turn) == pytest.approx(turn_deg, abs=0.15)
    assert line.estimate.distance == pytest.approx(1.8, abs=0.002)
    assert line.uprights == 2


def test_a_far_turn_is_found_where_the_heading_is_hardly_known() -> None:
    edges = posts(float(np.radians(9.0)), 1.8, (-2.0, 0.7, 2.5))
    line = front(edges, ROUGH)
    assert np.degrees(line.estimate.turn) == pytest.approx(9.0, abs=0.1)


def test_one_post_gives_the_distance_by_the_known_heading() -> None:
    edges = posts(0.0, 1.8, (0.7,))
    line = front(edges)
    turn, _ = line.estimate.sigma
    assert np.degrees(turn) > 0.5
    assert line.estimate.distance + 0.7 * line.estimate.turn == pytest.approx(1.8, abs=0.01)


@pytest.mark.parametrize(
    ("before", "places"),
    [
        (posts(0.0, 1.6, (-2.0, 0.7), votes=0.2), (-2.0, 0.7)),
        (Edges(np.array([[0.3, 1.65]]), np.array([0.9]), np.ones(1)), (-2.0, 0.7, 2.9)),
    ],
    ids=["low edges", "a single thing"],
)
def test_low_edges_and_a_single_thing_before_the_shelf_are_not_its_front(
    before: Edges, places: tuple[float, ...]
) -> None:
    line = front(joined(before, posts(0.0, 1.8, places)))
    assert line.estimate.distance == pytest.approx(1.8, abs=0.002)


def test_nothing_tall_gives_no_front() -> None:
    edges = posts(0.0, 1.8, (-2.0, 0.7), votes=0.2)
    assert upright_line(edges, edges.places, noise(edges), HERE, KNOWN) is None


def test_errors_of_the_line_are_as_stated() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(60):
        edges = posts(0.0, 1.8, (-2.0, 0.7))
        places = edges.places + rng.normal(0, 0.006, edges.places.shape)
        line = present(upright_line(edges, places, noise(edges, 0.006), HERE, KNOWN))
        off = np.array([line.estimate.turn, line.estimate.distance - 1.8])
        errors.append(off @ line.estimate.information @ off)
    assert 0.3 < np.mean(errors) < 2.4  # two in the mean; uprights of equal depth leave a part unused


def test_pallets_that_stand_unevenly_give_the_plane_within_its_sigma() -> None:
    rng = np.random.default_rng(4)
    squares = []
    for _ in range(200):
        along = np.array([-1.0, 0.3, 1.7, 3.0])
        pallets = np.stack(
            [along, 1.9 + rng.normal(0, 0.03, 4), np.pi / 2 + np.radians(rng.normal(0, 1.5, 4))], axis=1
        )
        found = present(pallet_line(pallets, np.eye(12) * 1e-6, HERE))
        off = np.array([found.turn, found.distance - 1.9])
        squares.append(off @ found.information @ off)
    assert np.mean(squares) == pytest.approx(2.0, rel=0.3)


def test_no_pallet_gives_no_plane() -> None:
    assert pallet_line(np.zeros((0, 3)), np.zeros((0, 0)), HERE) is None
