import numpy as np
import pytest

from calibration.shelf.front_line import pallet_line, upright_line
from calibration.shelf.plane import Foot
from calibration.shelf.upright_edges import Edges
from palletloc.geometry import FloatArray

FOOT = Foot(np.zeros(2), np.pi / 2)  # along x to the right, into the shelf along y
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


@pytest.mark.parametrize("turn_deg", [-1.5, 0.0, 0.8])
def test_the_front_corners_are_found_before_the_rear_ones(turn_deg: float) -> None:
    edges = posts(float(np.radians(turn_deg)), 1.8, (-2.0, 0.7))
    line = upright_line(edges, edges.places, noise(edges), FOOT, KNOWN)
    assert line is not None
    assert line.members.tolist() == [True, False, True, False] * 2
    assert np.degrees(line.estimate.turn) == pytest.approx(turn_deg, abs=0.15)
    assert line.estimate.distance == pytest.approx(1.8, abs=0.002)
    assert line.uprights == 2


def test_a_far_turn_is_found_where_the_heading_is_hardly_known() -> None:
    edges = posts(float(np.radians(9.0)), 1.8, (-2.0, 0.7, 2.5))
    line = upright_line(edges, edges.places, noise(edges), FOOT, ROUGH)
    assert line is not None
    assert np.degrees(line.estimate.turn) == pytest.approx(9.0, abs=0.1)


def test_one_post_gives_the_distance_by_the_known_heading() -> None:
    edges = posts(0.0, 1.8, (0.7,))
    line = upright_line(edges, edges.places, noise(edges), FOOT, KNOWN)
    assert line is not None
    turn, _ = line.estimate.sigma
    assert np.degrees(turn) > 0.5
    assert line.estimate.distance + 0.7 * line.estimate.turn == pytest.approx(1.8, abs=0.01)


def test_low_edges_before_the_shelf_are_not_its_front() -> None:
    guards = posts(0.0, 1.6, (-2.0, 0.7), votes=0.2)
    edges = joined(guards, posts(0.0, 1.8, (-2.0, 0.7)))
    line = upright_line(edges, edges.places, noise(edges), FOOT, KNOWN)
    assert line is not None
    assert line.estimate.distance == pytest.approx(1.8, abs=0.002)


def test_a_single_thing_before_the_shelf_is_not_its_front() -> None:
    lone = Edges(np.array([[0.3, 1.65]]), np.array([0.9]), np.ones(1))
    edges = joined(lone, posts(0.0, 1.8, (-2.0, 0.7, 2.9)))
    line = upright_line(edges, edges.places, noise(edges), FOOT, KNOWN)
    assert line is not None
    assert line.estimate.distance == pytest.approx(1.8, abs=0.002)


def test_nothing_tall_gives_no_front() -> None:
    edges = posts(0.0, 1.8, (-2.0, 0.7), votes=0.2)
    assert upright_line(edges, edges.places, noise(edges), FOOT, KNOWN) is None


def test_errors_of_the_line_are_as_stated() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(60):
        edges = posts(0.0, 1.8, (-2.0, 0.7))
        places = edges.places + rng.normal(0, 0.006, edges.places.shape)
        line = upright_line(edges, places, noise(edges, 0.006), FOOT, KNOWN)
        assert line is not None
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
        found = pallet_line(pallets, np.eye(12) * 1e-6, FOOT)
        assert found is not None
        off = np.array([found.turn, found.distance - 1.9])
        squares.append(off @ found.information @ off)
    assert np.mean(squares) == pytest.approx(2.0, rel=0.3)


def test_no_pallet_gives_no_plane() -> None:
    assert pallet_line(np.zeros((0, 3)), np.zeros((0, 0)), FOOT) is None
