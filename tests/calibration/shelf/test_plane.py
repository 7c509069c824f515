import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.shelf.plane import Foot, PlaneEstimate, disagreement, fuse, inverse_of
from palletloc.shelf import ShelfPlane

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
    one = said("a", 0.2, 2.0, 0.1, 0.01)
    fused = fuse([one, said("b", 0.2, 2.0, 0.1, 0.01)])
    assert fused is not None
    assert fused.covariance == pytest.approx(inverse_of(one.information) / 2)
    assert (fused.turn, fused.distance) == pytest.approx((one.turn, one.distance))


def test_the_surer_method_counts_more() -> None:
    fused = fuse([said("a", 0.0, 2.0, 0.1, 0.01), said("b", 0.0, 2.05, 0.1, 0.02)])
    assert fused is not None
    assert fused.distance == pytest.approx(2.01)


def test_a_heading_alone_leaves_the_distance_as_it_is() -> None:
    fused = fuse([said("a", 0.0, 2.0, 0.2, 0.01), heading_only("b", 0.2, 0.2)])
    assert fused is not None
    assert fused.distance == pytest.approx(2.0)
    assert np.degrees(fused.turn) == pytest.approx(0.1)
    assert fused.covariance[1, 1] == pytest.approx(0.01**2)


def test_headings_alone_give_no_plane() -> None:
    assert fuse([heading_only("a", 0.0, 0.1), heading_only("b", 0.0, 0.1)]) is None


def test_what_is_common_to_all_methods_is_added_once() -> None:
    common = np.diag([1e-6, 1e-4])
    one = said("a", 0.0, 2.0, 0.1, 0.01)
    alone, both = fuse([one], common), fuse([one, one], common)
    assert alone is not None
    assert both is not None
    assert alone.covariance - common == pytest.approx(2 * (both.covariance - common))


def test_the_two_that_disagree_most_are_named() -> None:
    found = disagreement(
        [said("uprights", 0, 2.0, 0.1, 0.005), said("beams", 0, 2.03, 0.1, 0.01), said("pallets", 0, 2.2, 0.5, 0.03)]
    )
    assert found is not None
    assert (found.first, found.second) == ("uprights", "pallets")
    assert found.distance == pytest.approx(0.2)


def test_a_heading_that_disagrees_is_found() -> None:
    found = disagreement([said("uprights", 0, 2.0, 0.1, 0.005), heading_only("lines", 1.0, 0.2)])
    assert found is not None
    assert np.isnan(found.distance)


def test_a_plane_that_lies_apart_says_as_much_of_the_heading() -> None:
    one = said("pallets", 0.3, 2.0, 0.2, 0.01)
    apart = one.apart(0.05)
    assert apart.sigma == pytest.approx((one.sigma[0], np.hypot(0.01, 0.05)))


def test_differences_are_as_rare_as_the_test_says() -> None:
    rng = np.random.default_rng(5)
    alarms, errors = 0, []
    for _ in range(2000):
        drawn = [
            said(name, float(rng.normal(0, s)), float(rng.normal(2, d)), s, d)
            for name, s, d in (("a", 0.1, 0.01), ("b", 0.3, 0.02))
        ]
        fused = fuse(drawn)
        assert fused is not None
        alarms += fused.disagreement is not None
        off = np.array([fused.turn, fused.distance - 2.0])
        errors.append(off @ np.linalg.solve(fused.covariance, off))
    assert alarms <= 15  # 5.4 expected
    assert np.mean(errors) == pytest.approx(2.0, rel=0.1)
