import dataclasses

import numpy as np
import pytest

from palletloc.evaluation.requirement import Requirement, Verdict, check_requirement


def test_the_limits_by_default_are_2_degrees_and_2_cm() -> None:
    assert Requirement().limits.tolist() == [0.02, 0.02, 0.02, np.radians(2)]


@pytest.mark.parametrize(("name", "column"), [("depth", 0), ("along", 1), ("height", 2), ("yaw", 3)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_each_quantity_has_its_own_limit(name: str, column: int, sign: int) -> None:
    requirement = dataclasses.replace(Requirement(), **{name: 0.5})
    offsets = np.zeros((3, 4))
    offsets[:, column] = np.array([0.49, 0.5, 0.51]) * sign
    checked = check_requirement(offsets, requirement)
    inside = {key: getattr(checked, key).proportion.successes for key in ("depth", "along", "height", "yaw")}
    assert inside.pop(name) == 2
    assert set(inside.values()) == {3}
    assert checked.together.proportion.successes == 2


def test_together_counts_what_is_inside_in_every_way() -> None:
    offsets = np.zeros((4, 4))
    offsets[0, 0] = offsets[1, 3] = 1.0
    checked = check_requirement(offsets)
    assert checked.depth.proportion.successes == checked.yaw.proportion.successes == 3
    assert checked.together.proportion.successes == 2


def test_59_good_errors_show_95_percent_and_58_do_not() -> None:
    # 0.95 ** 59 < 0.05 < 0.95 ** 58
    assert check_requirement(np.zeros((59, 4))).together.verdict is Verdict.MET
    assert check_requirement(np.zeros((58, 4))).together.verdict is Verdict.UNDECIDED


def test_errors_outside_show_that_it_is_not_met() -> None:
    # one outside has a chance of 0.1, two of 0.01
    requirement = Requirement(share=0.9, confidence=0.95)
    assert check_requirement(np.ones((1, 4)), requirement).together.verdict is Verdict.UNDECIDED
    assert check_requirement(np.ones((2, 4)), requirement).together.verdict is Verdict.NOT_MET


def test_a_true_share_at_the_limit_is_called_met_no_oftener_than_the_confidence_allows() -> None:
    rng = np.random.default_rng(4)
    requirement = Requirement(share=0.8, confidence=0.9)
    offsets = np.where(rng.uniform(size=(400, 60, 1)) < 0.8, 0.0, 1.0) * np.ones(4)
    verdicts = [check_requirement(run, requirement).together.verdict for run in offsets]
    for wrong in (Verdict.MET, Verdict.NOT_MET):
        assert verdicts.count(wrong) / len(verdicts) <= 0.1 + 0.03


def test_missed_pallets_count_as_outside_where_asked() -> None:
    checked = check_requirement(np.zeros((8, 4)), missed=2)
    assert checked.yaw.proportion.value == checked.together.proportion.value == 0.8


def test_no_errors_decide_nothing() -> None:
    assert check_requirement(np.zeros((0, 4))).together.verdict is Verdict.UNDECIDED


def test_values_that_are_not_finite_are_outside() -> None:
    assert check_requirement(np.full((1, 4), np.nan)).yaw.proportion.successes == 0


@pytest.mark.parametrize("wrong", [{"depth": 0.0}, {"yaw": -1.0}, {"share": 1.0}, {"confidence": 0.0}])
def test_an_impossible_requirement_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=rf"requirement\.{next(iter(wrong))}: expected"):
        Requirement(**wrong)


def test_errors_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(n, 4\), got \(4,\)"):
        check_requirement(np.zeros(4))
