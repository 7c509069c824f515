import numpy as np
import pytest

from tracking.state import (
    COMMON,
    CONSTANTS,
    POSE,
    Gaussian,
    Key,
    TrackGroup,
    members_of,
    places_of,
    regrouped,
    size_of,
)

A, B, C, D, E = (Key(0.0, name) for name in "abcde")


def drawn(seed: int, count: int) -> Gaussian:
    """Return a state in which all depend on each other."""
    rng, size = np.random.default_rng(seed), 2 + 8 * count
    root = rng.normal(size=(size, size))
    return Gaussian(rng.normal(size=size), root @ root.T + np.eye(size))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_group_has_the_constants_once_and_eight_numbers_for_each_pallet(count: int) -> None:
    places, state = places_of(count), drawn(1, count)
    assert size_of(count) == 2 + 8 * count == len(np.unique(places))
    assert (places[:, CONSTANTS] == [4, 5]).all()
    for member, place in zip(members_of(state), places, strict=True):
        np.testing.assert_array_equal(member.mean, state.mean[place])
        np.testing.assert_array_equal(member.covariance, state.covariance[np.ix_(place, place)])


def test_what_stays_of_a_group_is_its_marginal() -> None:
    group = TrackGroup((A, B, C), drawn(2, 3), carried=(A, B))
    left = group.kept([C, A])
    assert (left.keys, left.carried) == ((C, A), (A,))
    for key in left.keys:
        np.testing.assert_array_equal(left.members[key].covariance, group.members[key].covariance)
    np.testing.assert_array_equal(left.kept([A, C]).state.covariance, group.kept([A, C]).state.covariance)
    assert group.kept([A, B, C]) is group


def test_new_tracks_go_where_there_is_room_and_what_began_anew_knows_nothing_of_the_others() -> None:
    first, fresh = TrackGroup((A, B, C), drawn(3, 3)), drawn(4, 1)
    group, other = regrouped([first], [(D, fresh), (E, fresh)], {A, C, D, E}, 3)
    assert (group.keys, other.keys) == ((A, C, D), (E,))
    np.testing.assert_array_equal(group.members[C].covariance, first.members[C].covariance)
    (anew,) = regrouped([first], [(B, fresh)], {A, B, C}, 3)
    assert anew.keys == (A, C, B)
    of_others = np.concatenate(places_of(3)[:2])
    own = places_of(3)[2, np.r_[POSE, COMMON]]
    assert not anew.state.covariance[np.ix_(of_others, own)].any()
    np.testing.assert_array_equal(anew.members[B].mean[POSE], fresh.mean[POSE])
    constants = anew.members[B].covariance[CONSTANTS, CONSTANTS]
    np.testing.assert_array_equal(constants, first.members[A].covariance[CONSTANTS, CONSTANTS])
    assert regrouped([first], [], set(), 3) == []
