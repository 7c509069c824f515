from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from palletloc.survey.plan import read_survey_plan
from palletloc.survey.point import Survey, SurveyError, SurveyPoint
from palletloc.survey.truth import read_surveyed_truth, survey_truth

Points = dict[str, list[float]]
Change = Callable[[Points], Points]
STATION = np.array([411.0, 192.0, 13.0])


def swapped(first: str, second: str) -> Change:
    return lambda points: {**points, first: points[second], second: points[first]}


def scaled(factor: float) -> Change:
    return lambda points: {name: [factor * value for value in place] for name, place in points.items()}


def moved(name: str, east: float) -> Change:
    return lambda points: {**points, name: [points[name][0] + east, *points[name][1:]]}


def dropped(*names: str) -> Change:
    return lambda points: {name: place for name, place in points.items() if name not in names}


def elsewhere(points: Points) -> Points:
    rng = np.random.default_rng(3)
    return {name: rng.uniform(0, 300, 3).tolist() for name in points}


def write_points(lab: Path, points: Points) -> None:
    rows = [f"{name},{x:.5f},{y:.5f},{z:.5f}" for name, (x, y, z) in points.items()]
    (lab / "truth" / "survey.csv").write_text("\n".join(["name,x_m,y_m,z_m", *rows]))


def solve(lab: Path, points: Mapping[str, SurveyPoint]) -> None:
    survey_truth(read_survey_plan(lab / "truth" / "survey.yaml"), Survey(Path("survey.csv"), dict(points)))


def named(points: Points) -> dict[str, SurveyPoint]:
    return {name: SurveyPoint(name, np.array(place), (1,)) for name, place in points.items()}


FAULTS = [
    (swapped("V1-S1", "V2-S1"), r"csv, lines 2 and 3: points 'V1-S1' and 'V2-S1' look swapped: .* stop 'S1'"),
    (swapped("A-LL", "A-LR"), r"lines 8 and 9: points 'A-LL' and 'A-LR' look swapped: .* body 'A'"),
    (swapped("A-LL", "A-UL"), r"lines 8 and 10: points 'A-LL' and 'A-UL' look swapped"),
    (
        swapped("V1-S1", "V1-S2"),
        r"lines 2 and 5: point 'V1-S1' does not fit the others of stop 'S1', but point 'V1-S2' does",
    ),
    (scaled(1 / 0.3048), r"lines 2 and 4: .* are 6\.\d+ m apart: distances are 3\.28.. times .*: in feet, expected"),
    (scaled(1000), r"lines 2 and 4: .*: in millimetres, expected metres"),
    (scaled(0.3048), r"metres that are marked as feet"),
    (scaled(10), r"lines 2 and 4: .*: distances are 10 times the body's: is the unit digit of the words wrong\?"),
    (moved("V3-S2", 2000.0), r"line 7: point 'V3-S2' .* up to \d{4}\S* m off; do its coordinates"),
    (
        scaled(1.01),
        r"lines \d and \d: points '.*' and '.*' are \S+ m apart, expected \S+ m on stop 'S1' .scale 1\.01",
    ),
    (moved("V3-S2", 0.2), r"line 7: point 'V3-S2' does not fit the others of stop 'S2': .* up to"),
    (elsewhere, r"lines 2 and 4: .*: is it the survey of another site\?"),
    (
        lambda points: {name: [x + 4000 * ("-S" not in name), y, z] for name, (x, y, z) in points.items()},
        r"lines 8, 9 and 10: body 'A' \(A-LL\) is \d+\.\d m from the forklift at stop 'S1', expected at",
    ),
    (
        lambda points: {f"Q{name}": place for name, place in points.items()},
        r"has none of the points that .*survey\.yaml names \('V1-S1' and others\); .* another site",
    ),
    (
        dropped("V1-S2", "V3-S2"),
        r"line 5: stop 'S2' has only point 'V2-S2' \(line 5\); expected at least 2 of V1-S2, V2-S2, V3-S2",
    ),
    (dropped("V1-S2", "V2-S2", "V3-S2"), r"csv: stop 'S2' has no point; expected at least 2 of V1-S2"),
    (dropped("B-LL", "B-UR"), r"line 11: body 'B' has only point 'B-LR' \(line 11\)"),
    (
        lambda points: {name: [y, x, z] for name, (x, y, z) in points.items()},
        r"lines 2, 3 and 4: stop 'S1' tilts by \S+ degrees.*with easting and northing exchanged it does",
    ),
]


@pytest.mark.parametrize(("change", "said"), FAULTS)
def test_a_survey_that_cannot_be_right_is_one_line_with_file_line_and_point(
    lab: Path, lab_points: Points, change: Change, said: str
) -> None:
    write_points(lab, change(lab_points))
    with pytest.raises(SurveyError, match=said) as caught:
        read_surveyed_truth(lab)
    message = str(caught.value)
    assert "\n" not in message
    assert str(lab / "truth" / "survey.csv") in message


def test_a_missing_point_names_the_line_that_was_rejected(lab: Path) -> None:
    survey = "110001+000V1-S1 81..00+00001000 82..00+00002000 83..00+00003000\n110002+000V2-S1 81..00+0000"
    (lab / "truth" / "survey.gsi").write_text(survey)
    edited_plan(lab, {"survey.csv": "survey.gsi"})
    said = (
        r"line 1: stop 'S1' has only point 'V1-S1' .* \(1 rejected lines, the first: line 2: column 17: word 81 has 4"
    )
    with pytest.raises(SurveyError, match=said):
        read_surveyed_truth(lab)


def edited_plan(lab: Path, changes: Mapping[str, str]) -> None:
    path = lab / "truth" / "survey.yaml"
    text = path.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


def test_targets_on_one_line_are_refused_unless_the_body_is_stated_to_be_level(lab: Path, lab_points: Points) -> None:
    line = {"A-LL": 0.55, "A-LR": -0.55, "A-UL": 0.1}
    start, end = (np.array(lab_points[name]) for name in ("A-LL", "A-LR"))
    lab_points["A-UL"] = (start + (0.55 - line["A-UL"]) / 1.1 * (end - start)).tolist()
    edited_plan(lab, {"    - 0.132\n  B:": "    - 0.012\n  B:"})
    text = (lab / "truth" / "survey.yaml").read_text()
    at = text.index("A-UL")
    (lab / "truth" / "survey.yaml").write_text(text[:at] + text[at:].replace("0.55", "0.1", 1))
    write_points(lab, lab_points)
    said = r"lines 8, 9 and 10: body 'A' \(A-LL, A-LR, A-UL\): its 3 points lie on one line, .* state 'level: true'"
    with pytest.raises(SurveyError, match=said):
        read_surveyed_truth(lab)
    edited_plan(lab, {"file:": "level: true\nfile:"})
    assert read_surveyed_truth(lab).pallets[0].fit.assumed_level


def test_two_targets_above_one_another_and_a_pallet_seen_from_behind_are_refused(
    lab: Path, lab_points: Points
) -> None:
    with pytest.raises(SurveyError, match=r"body 'A' \(A-LL, A-UL\): its 2 points stand above .* lacks A-LR"):
        solve(lab, named(dropped("A-LR")(lab_points)))
    with pytest.raises(SurveyError, match=r"body 'A' shows the forklift its back at every stop; .*\(A-LL, A-LR\)"):
        solve(lab, named(dropped("A-UL")(swapped("A-LL", "A-LR")(lab_points))))


@pytest.mark.parametrize("error", [0.0344, -0.0344, 0.0175])
def test_a_wrong_prism_constant_is_told_from_foreign_units(lab: Path, lab_points: Points, error: float) -> None:
    points = {}
    for number, (name, place) in enumerate(lab_points.items(), start=1):
        toward = (np.array(place) - STATION) / np.linalg.norm(np.array(place) - STATION)
        points[name] = SurveyPoint(name, np.array(place) + error * toward, (number,), toward)
    how = "long" if error > 0 else "short"
    said = rf"all distances from the instrument are {abs(error) * 1e3:.1f} mm too {how} .*: a wrong prism constant"
    with pytest.raises(SurveyError, match=said):
        solve(lab, points)


def test_a_mirrored_solid_body_is_named_as_such(lab: Path, lab_points: Points) -> None:
    edited_plan(lab, {"    V3:": "    V4:\n    - 0.3\n    - 0.5\n    - 0.4\n    V3:"})
    plan = read_survey_plan(lab / "truth" / "survey.yaml")
    body = np.array(list(plan.bodies["forklift"].values()))
    for stop in ("S1", "S2"):
        names = [f"{name}-{stop}" for name in plan.bodies["forklift"]]
        lab_points |= dict(zip(names, (-body + 400).tolist(), strict=True))
    with pytest.raises(SurveyError, match=r"point 'V.-S1' is .* mm off the fit of stop 'S1'; they fit its mirror"):
        solve(lab, named(lab_points))
