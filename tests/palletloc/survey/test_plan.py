from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palletloc.io.reading import InputError
from palletloc.survey.plan import read_survey_plan
from palletloc.survey.prism import LEICA_CONSTANTS, PrismConstant, PrismConvention, PrismUse
from palletloc.survey.reading import read_survey

PLAN = """\
file: survey.gsi
sigma_m: 0.0006
stops: [{name: S1, time_s: 1.05}, {name: S2, time_s: 3.16}]
bodies:
  forklift: {V1: [-0.9, 0.45, 2.10], V2: [-0.9, -0.45, 2.08], V3: [0.55, -0.40, 1.20]}
  A: {A-LL: [0, 0.55, 0.012], A-LR: [0, -0.55, 0.012], 7: [0, 0.55, 0.132]}
"""


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_plan_is_read(tmp_path: Path) -> None:
    plan = read_survey_plan(written(tmp_path, "survey.yaml", PLAN))
    assert plan.survey == tmp_path / "survey.gsi"
    assert [(stop.name, stop.time) for stop in plan.stops] == [("S1", 1.05), ("S2", 3.16)]
    assert plan.pallets == ("A",)
    assert_allclose(plan.bodies["forklift"]["V3"], [0.55, -0.40, 1.20])
    assert list(plan.bodies["A"]) == ["A-LL", "A-LR", "7"]
    assert (plan.sigma, plan.level, plan.prism, plan.known) == (0.0006, False, None, None)


def test_a_plan_may_state_prism_known_points_and_level_bodies(tmp_path: Path) -> None:
    more = "level: true\nprism: {constant_mm: 0, convention: absolute, set_mm: 17.5}\nknown: {K1: [1, 2, 3]}\n"
    plan = read_survey_plan(written(tmp_path, "survey.yaml", PLAN + more))
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
        (PLAN[PLAN.index("  A:") :], "", r"expected at least one pallet beside 'forklift'"),
    ],
)
def test_a_bad_plan_is_one_line_that_names_the_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in PLAN
    with pytest.raises(InputError, match=said) as caught:
        read_survey_plan(written(tmp_path, "survey.yaml", PLAN.replace(old, new)))
    assert "\n" not in str(caught.value)


LANDXML = """\
<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
  <Units><Metric areaUnit="squareMeter" linearUnit="meter" volumeUnit="cubicMeter"/></Units>
  <CgPoints>
    <CgPoint name="A-LL">190.6996 413.7033 11.6112</CgPoint>
    <CgPoints name="group">
      <CgPoint name="A-LR" code="target">
        191.3436 414.5943
        11.6120
      </CgPoint>
    </CgPoints>
  </CgPoints>
</LandXML>
"""
PLACES = {"A-LL": [413.7033, 190.6996, 11.6112], "A-LR": [414.5943, 191.3436, 11.6120]}


def test_landxml_gives_northing_before_easting(tmp_path: Path) -> None:
    survey = read_survey(written(tmp_path, "a.xml", LANDXML))
    for name, place in PLACES.items():
        assert_allclose(survey.require(name).position, place)
    assert survey.require("A-LR").lines == (7,)
    assert list(survey.remarks()) == []


@pytest.mark.parametrize("prefix", ["", "lx:"])
@pytest.mark.parametrize("name", ["1.0", "1.1", "2.0"])
def test_any_version_and_prefix_of_landxml_is_read(tmp_path: Path, prefix: str, name: str) -> None:
    text = LANDXML.replace("LandXML-1.2", f"LandXML-{name}")
    for tag in ("LandXML", "Units", "Metric", "CgPoints", "CgPoint "):
        text = text.replace(f"<{tag}", f"<{prefix}{tag}").replace(f"</{tag.strip()}>", f"</{prefix}{tag.strip()}>")
    text = text.replace("xmlns=", f"xmlns:{prefix[:-1]}=" if prefix else "xmlns=")
    assert len(read_survey(written(tmp_path, "a.xml", text)).points) == 2


def test_the_linear_unit_of_landxml_is_obeyed(tmp_path: Path) -> None:
    start, end = LANDXML.index("<Metric"), LANDXML.index("</Units>")
    for unit, metres in (
        ('<Imperial linearUnit="foot"/>', 0.3048),
        ('<Imperial linearUnit="USSurveyFoot"/>', 0.3048006096),
        ('<Metric linearUnit="millimeter"/>', 0.001),
    ):
        survey = read_survey(written(tmp_path, "a.xml", LANDXML[:start] + unit + LANDXML[end:]))
        assert_allclose(survey.require("A-LL").position, np.multiply(PLACES["A-LL"], metres), rtol=1e-10)


def test_points_of_landxml_without_three_numbers_are_listed(tmp_path: Path) -> None:
    extra = '<CgPoint name="flat">1 2</CgPoint>\n<CgPoint pntRef="A-LL"/>\n</CgPoints>\n</LandXML>'
    text = LANDXML.replace("</CgPoints>\n</LandXML>", extra).replace("Units>", "Unit>")
    survey = read_survey(written(tmp_path, "a.xml", text.replace("<Metric", "<Other")))
    assert [note.line for note in survey.rejected] == [12, 13]
    assert "expected northing, easting, elevation, got '1 2'" in survey.rejected[0].text
    assert [note.text for note in survey.notes] == ["has no Units; metres are assumed"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('linearUnit="meter"', 'linearUnit="metre"', r"line 3: unknown linearUnit 'metre'; did you mean 'meter'\?"),
        ('"A-LR"', '"A-LL"', r"line 7: point 'A-LL' stands in line 5 already"),
        ("</LandXML>", "", r"a\.xml, line 1\d: is not XML: "),
        ("LandXML", "html", r"a\.xml: expected the element LandXML, got 'html'"),
        ("CgPoint ", "Point ", r"a\.xml.*is not XML|a\.xml: has no points"),
        ("<LandXML", "<!DOCTYPE x><LandXML", r"line 2: expected LandXML without a DOCTYPE"),
    ],
)
def test_bad_landxml_is_one_line_with_its_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in LANDXML
    with pytest.raises(InputError, match=said) as caught:
        read_survey(written(tmp_path, "a.xml", LANDXML.replace(old, new)))
    assert "\n" not in str(caught.value)


def test_a_table_gives_its_points(tmp_path: Path) -> None:
    rows = "\n".join(f"{name},{x},{y},{z}" for name, (x, y, z) in PLACES.items())
    survey = read_survey(written(tmp_path, "a.CSV", f"name,x_m,y_m,z_m\r\n{rows}"))
    for name, place in PLACES.items():
        assert_allclose(survey.require(name).position, place)
    assert survey.require("A-LR").lines == (3,)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,x_m,y_m\nA,1,2\n", r"line 1: column 'z_m' is missing"),
        ("name,x_ft,y_m,z_m\nA,1,2,3\n", r"line 1: unknown column 'x_ft'; known are name, x_m, y_m, z_m"),
        ("name,x_m,y_m,z_m,colour\nA,1,2,3,t\n", r"line 1: unknown column 'colour'"),
        ("name,x_m,y_m,z_m\nA,1,2,3\nA,1,2,3\n", r"line 3: name: 'A' stands in line 2 already"),
        ("name,x_m,y_m,z_m\nA,1,nan,3\n", r"line 2: y_m: expected a finite number"),
        ("name,x_m,y_m,z_m\nA,1,2\n", r"line 2: expected 4 cells, got 3"),
    ],
)
def test_a_bad_table_is_one_line_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_survey(written(tmp_path, "a.csv", text))


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.txt: unknown kind of survey; expected a name that ends with \.gsi"):
        read_survey(written(tmp_path, "a.txt", ""))
    with pytest.raises(InputError, match=r"no such file"):
        read_survey(tmp_path / "b.gsi")
    with pytest.raises(InputError, match=r"a\.xml: holds no distances"):
        read_survey(written(tmp_path, "a.xml", LANDXML), PrismUse(PrismConstant(0.0)))


def test_the_two_conventions_of_prism_constants_are_34_4_mm_apart() -> None:
    for constant in LEICA_CONSTANTS.values():
        leica = PrismConstant(constant)
        again = PrismConstant(leica.absolute, PrismConvention.ABSOLUTE)
        assert again.leica == pytest.approx(constant, abs=1e-12)
        assert leica.leica - leica.absolute == pytest.approx(0.0344)
    # Without glass there is no detour: in the absolute convention tape has none.
    assert PrismConstant(LEICA_CONSTANTS["tape"]).absolute == pytest.approx(0, abs=1e-12)
