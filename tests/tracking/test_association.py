import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from palletloc.footprint import overlapping
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet_library import load_library
from tracking.association import Footprints, Standing

LIBRARY = load_library()
SURE = 1e-12 * np.eye(4)
STANDINGS = st.builds(
    lambda x, y, z, yaw, model: Standing(np.array([x, y, z, yaw]), SURE, model),
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.sampled_from([0.0, 0.1, 0.2, 1.5]),
    st.floats(-3, 3),
    st.sampled_from(sorted(LIBRARY)),
)


def in_each_other(one: Standing, other: Standing) -> bool:
    poses = [LevelPose(*it.pose.tolist()) for it in (one, other)]
    models = [LIBRARY[it.model] for it in (one, other)]
    there = overlapping(poses[0], models[0], poses[1], models[1])
    return there or overlapping(poses[1], models[1], poses[0], models[0])


@given(st.lists(STANDINGS, max_size=6))
def test_pallets_share_a_place_as_two_of_them_do(pallets: list[Standing]) -> None:
    footprints = Footprints()
    count = len(pallets)
    expected = [(i, j) for i in range(count) for j in range(i + 1, count) if in_each_other(pallets[i], pallets[j])]
    assert footprints.sharing(pallets) == expected
    for i, one in enumerate(pallets):
        found = footprints.same_place(one, pallets)
        assert found[i]
        assert {j for j in range(count) if found[j]} == {i} | {sum(pair) - i for pair in expected if i in pair}


def test_an_uncertain_height_reaches_farther() -> None:
    def standing(z: float, covariance: FloatArray) -> Standing:
        return Standing(np.array([2.0, 1.0, z, 0.3]), covariance, "epal1-1200")

    footprints = Footprints()
    assert not footprints.sharing([standing(0.0, SURE), standing(0.3, SURE)])
    assert footprints.sharing([standing(0.0, SURE), standing(0.3, np.diag([1e-4, 1e-4, 0.06**2, 1e-4]))])


def test_an_unknown_model_is_taken_for_the_smallest_of_the_library() -> None:
    names = Footprints().names
    narrowest = min(names, key=lambda name: LIBRARY[name].width)
    for off in np.linspace(0.0, 2.0, 21):
        one, other = np.array([2.0, 1.0, 0.0, 0.0]), np.array([2.0, 1.0 + off, 0.0, 0.0])
        unknown = [Standing(pose, SURE, "mine") for pose in (one, other)]
        known = [Standing(pose, SURE, narrowest) for pose in (one, other)]
        assert Footprints().sharing(unknown) == Footprints().sharing(known)


def test_models_of_the_site_are_the_only_ones_taken() -> None:
    site = Footprints([LIBRARY["epal1-1200"]])
    assert site.accepts("epal1-1200")
    assert not site.accepts("epal1-800")
    assert Footprints().accepts("anything")
