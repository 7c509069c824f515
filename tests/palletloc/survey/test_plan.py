from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from palletloc.io.reading import InputError
from palletloc.survey.plan import read_survey_plan
from palletloc.survey.prism import PrismConvention

PLAN = """\
file: survey.gsi
sigma_m: 0.0006
stops: [{name: S1, time_s: 1.05}, {name: S2, time_s: 3.16}]
bodies:
  forklift: {V1: [-0.9, 0.45, 2.10], V2: [-0.9, -0.45, 2.08], V3: [0.55, -0.40, 1.20]}
  A: {A-LL: [0, 0.55, 0.012], A-LR: [0, -0.55, 0.012], 7: [0, 0.55, 0.132]}
"""


def written(folder: Path, text: str = PLAN) -> Path:
    path = folder / "survey.yaml"
    path.write_text(text)
    return path


def test_a_plan_is_read(tmp_path: Path) -> None:
    plan = read_survey_plan(written(tmp_path))
    assert plan.survey == tmp_path / "survey.gsi"
    assert [(stop.name, stop.time) for stop in plan.stops] == [("S1", 1.05), ("S2", 3.16)]
    assert plan.pallets == ("A",)
    assert_allclose(plan.bodies["forklift"]["V3"], [0.55, -0.40, 1.20])
    assert list(plan.bodies["A"]) == ["A-LL", "A-LR", "7"]
    assert (plan.sigma, plan.level, plan.prism, plan.known) == (0.0006, False, None, None)


def test_a_plan_may_state_prism_known_points_and_level_bodies(tmp_path: Path) -> None:
    more = "level: true\nprism: {constant_mm: 0, convention: absolute, set_mm: 17.5}\nknown: {K1: [1, 2, 3]}\n"
    plan = read_survey_plan(written(tmp_path, PLAN + more))
    assert plan.level
    assert plan.prism is not None
    assert plan.prism.true.convention is PrismConvention.ABSOLUTE
    assert plan.prism.correction(None) == pytest.approx(0.0344 - 0.0175)
    assert plan.known is not None
    assert_allclose(plan.known["K1"], [1, 2, 3])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("sigma_m: 0.0006", "sigma_m: 0", r"survey\.yaml: sigma_m: expected a finite positive number, got 0"),
        ("sigma_m", "sigma_mm", r"unknown key 'sigma_mm'; did you mean 'sigma_m'"),
        ("name: S2", "name: S1", r"stops: name S1 stands there twice"),
        ("time_s: 3.16", "time_s: 1.05", r"stops: time_s 1\.05 stands there twice"),
        ("stops: [{name: S1, time_s: 1.05}, {name: S2, time_s: 3.16}]", "stops: []", r"stops: expected at least 1"),
        ("forklift:", "truck:", r"bodies: no body 'forklift', got truck, A"),
        ("A-LR:", "V1:", r"bodies\.A: target 'V1' is on 'forklift' already"),
        ("[0, 0.55, 0.012]", "[0, 0.55]", r"bodies\.A\.A-LL: expected 3 finite numbers"),
        ("A-LR: [0, -0.55, 0.012], 7: [0, 0.55, 0.132]", "", r"bodies\.A: has 1 targets, expected at least 2"),
        ("file: survey.gsi\n", "", r"file: is missing"),
    ],
)
def test_a_bad_plan_is_one_line_that_names_the_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in PLAN
    with pytest.raises(InputError, match=said) as caught:
        read_survey_plan(written(tmp_path, PLAN.replace(old, new)))
    assert "\n" not in str(caught.value)


def test_a_plan_without_pallets_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected at least one pallet beside 'forklift'"):
        read_survey_plan(written(tmp_path, PLAN[: PLAN.index("  A:")]))
