"""Survey files as people have them: tables in any order and form of numbers, XML, and what is not read."""

from pathlib import Path

import pytest
import yaml
from numpy.testing import assert_allclose

from palletloc.io.reading import InputError
from palletloc.survey.point import SurveyError
from palletloc.survey.reading import read_survey
from palletloc.survey.truth import read_surveyed_truth

PLACES = {"A-LL": [413.7033, 190.6996, 11.6112], "A-LR": [414.5943, 191.3436, 11.6120]}


def written(folder: Path, text: str, name: str = "points.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def assert_places(path: Path, columns: tuple[str, ...] | None = None) -> None:
    survey = read_survey(path, columns=columns)
    assert set(survey.points) == set(PLACES)
    for name, place in PLACES.items():
        assert_allclose(survey.require(name).position, place, atol=1e-9)


TABLES = {
    "PENH": "P,E,N,H\nA-LL,413.7033,190.6996,11.6112\nA-LR,414.5943,191.3436,11.6120\n",
    "code": "name,x_m,y_m,z_m,code\nA-LL,413.7033,190.6996,11.6112,corner\nA-LR,414.5943,191.3436,11.6120,\n",
    "code first": "Point ID;Code;Northing;Easting;Elevation\n"
    "A-LL;7;190.6996;413.7033;11.6112\nA-LR;7;191.3436;414.5943;11.6120\n",
    "german": "Punktnummer;Rechtswert [m];Hochwert [m];H\N{LATIN SMALL LETTER O WITH DIAERESIS}he [m];Bemerkung\n"
    "A-LL;413,7033;190,6996;11,6112;Ecke\nA-LR;414,5943;191,3436;11,6120;\n",
    "right and up": "Pkt;R;H;Z\nA-LL;413,7033;190,6996;11,6112\nA-LR;414,5943;191,3436;11,6120\n",
    "height first": "# a comment\nH\tNord\tOst\tNr.\n"
    "11,6112\t190,6996\t413,7033\tA-LL\n11,6120\t191,3436\t414,5943\tA-LR\n",
    "blanks": "Name  North  East  Height\nA-LL   190.6996 413.7033  11.6112\nA-LR   191.3436 414.5943  11.6120\n",
    "millimetres": "name,E_mm,N_mm,H_mm\nA-LL,413703.3,190699.6,11611.2\nA-LR,414594.3,191343.6,11612.0\n",
    "quotes": '\ufeff"Name","East","North","Elev"\n'
    '"A-LL","413.7033","190.6996","11.6112"\n"A-LR",414.5943,191.3436,11.612\n',
}


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("name", ["points.csv", "points.txt", "points.pts"])
def test_a_table_is_read_by_the_names_of_its_columns(tmp_path: Path, kind: str, name: str) -> None:
    assert_places(written(tmp_path, TABLES[kind], name))


HEADERLESS = {
    "PENZ": ("A-LL 413.7033 190.6996 11.6112\nA-LR 414.5943 191.3436 11.6120\n", ("P", "E", "N", "Z")),
    "PNEZD": ("A-LL,190.6996,413.7033,11.6112,corner\nA-LR,191.3436,414.5943,11.6120,x\n", ("P", "N", "E", "Z", "D")),
    "semicolons": ("A-LL;413,7033;190,6996;11,6112\nA-LR;414,5943;191,3436;11,6120\n", ("Punkt", "Ost", "Nord", "H")),
    "a header": (
        "a,b,c,d\nA-LL,413.7033,190.6996,11.6112\nA-LR,414.5943,191.3436,11.6120\n",
        ("name", "x", "y", "z"),
    ),
}


@pytest.mark.parametrize("kind", HEADERLESS)
def test_a_table_without_header_is_read_by_stated_columns(tmp_path: Path, kind: str) -> None:
    text, columns = HEADERLESS[kind]
    assert_places(written(tmp_path, text, "points.txt"), columns)
    with pytest.raises(SurveyError, match=r"points\.txt, line 1: no header .* 'columns: P,E,N,H' in survey\.yaml"):
        read_survey(tmp_path / "points.txt")


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        ("P,Y,X,Z\nA,1,2,3\n", None, r"line 1: y stands before x: is y the easting\?"),
        ("A 1 2 3\n", ("P", "Y", "X", "Z"), r"line 1: y stands before x: is y the easting\?"),
        ("A 1 2 3\n", ("P", "E", "N"), r"columns: no column for z among P, E, N"),
        ("A 1 2\n", ("P", "E", "N", "H"), r"line 1: expected at least 4 cells, got 3"),
        ("P,E,N,H\nA,1,2,3\nB,1,two,3\n", None, r"line 3: y_m: expected a finite number, got 'two'"),
        ("P,E,N,H\nA,1,2,3\nA,4,5,6\n", None, r"line 3: name: 'A' stands in line 2 already"),
        ("P,E,N,H\n", None, r"has no rows"),
        ("P;E;N;H\nA;1,5;nan;3\n", None, r"line 2: y_m: expected a finite number"),
    ],
)
def test_a_bad_table_is_one_line(tmp_path: Path, text: str, columns: tuple[str, ...] | None, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read_survey(written(tmp_path, text, "a.txt"), columns=columns)
    assert "\n" not in str(caught.value)


def test_columns_that_nobody_knows_are_noted(tmp_path: Path) -> None:
    survey = read_survey(written(tmp_path, "P,E,N,H,Quality\nA,1,2,3,0.9\n"))
    assert [note.text for note in survey.notes] == ["columns that are not used: Quality"]


LANDXML = """<?xml version="1.0"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2"><Units><Metric linearUnit="meter"/></Units>
<CgPoints>
<CgPoint name="B" pntRef="A"/>
<CgPoint name="A">190.5 413.5 11.25</CgPoint>
<CgPoint name="A">190.50 413.5 11.25</CgPoint>
<CgPoint name="C" pntRef="none"/>
<CgPoint pntRef="A"/>
</CgPoints></LandXML>
"""


def test_points_of_landxml_may_refer_to_others_and_stand_there_again(tmp_path: Path) -> None:
    survey = read_survey(written(tmp_path, LANDXML, "a.txt"))
    for name in "AB":
        assert survey.require(name).position.tolist() == [413.5, 190.5, 11.25]
    assert [(note.line, note.text) for note in survey.notes] == [(6, "point 'A' is that of line 5 again")]
    assert [note.text for note in survey.rejected] == [
        "point 'C': only refers to point 'none'",
        "point '': has no name and only refers to point 'A'",
    ]
    with pytest.raises(SurveyError, match=r"line 6: point 'A' stands in line 5 already; .* or equal coordinates"):
        read_survey(written(tmp_path, LANDXML.replace("190.50", "190.51")))
    sights = '<LandXML><Survey><RawObservation horizAngle="1" zenithAngle="90"/></Survey></LandXML>'
    with pytest.raises(SurveyError, match=r"has no points .*; its observations are not reduced: export points"):
        read_survey(written(tmp_path, sights))


JOBXML = """<?xml version="1.0" encoding="UTF-8"?>
<JOBFile jobName="hall" version="5.76"><Environment><DisplaySettings><DistanceUnits>USSurveyFeet</DistanceUnits>
</DisplaySettings></Environment>
<FieldBook><PointRecord ID="1"><Name>A-LL</Name><Grid><North>1</North><East>2</East><Elevation>3</Elevation></Grid>
</PointRecord></FieldBook>
<Reductions>
<Point><ID>1</ID><Name>A-LL</Name><Code/><Grid><North>190.6996</North><East>413.7033</East><Elevation>11.6112</Elevation></Grid></Point>
<Point><ID>2</ID><Name>A-LR</Name><Grid><North>191.3436</North><East>414.5943</East><Elevation>11.6120</Elevation></Grid></Point>
<Point><ID>3</ID><Name>old</Name><Deleted>true</Deleted><Grid><North>1</North><East>1</East><Elevation>1</Elevation></Grid></Point>
<Point><ID>4</ID><Name>flat</Name><Grid><North>1</North><East>1</East><Elevation/></Grid></Point>
</Reductions></JOBFile>
"""


def test_the_reductions_of_trimble_jobxml_are_read(tmp_path: Path) -> None:
    path = written(tmp_path, JOBXML, "job.jxl")
    assert_places(path)
    assert [note.line for note in read_survey(path).rejected] == [10]


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("00NMSDR33V04-04.02\n", "a Sokkia or Trimble field book"),
        ("For M5|Adr 1|TI  ORTHO\n", "a field book of Zeiss"),
        ("50=JOB1\n2=ST1\n3=1.5\n", "a field book of Geodimeter"),
        ("JB,NMhall,DT01-01-2024\n", "a raw file of Carlson"),
        ("CO,Nikon RAW data format V2.00\n", "a raw file of Nikon"),
        ("PK\3\4rest", "an Excel workbook"),
        ("  0\nSECTION\n  2\nHEADER\n", "a drawing"),
    ],
)
def test_what_is_not_read_is_named_with_what_to_do(tmp_path: Path, text: str, kind: str) -> None:
    with pytest.raises(SurveyError, match=rf"a\.csv: is {kind}.*; expected its points exported as GSI, LandXML or"):
        read_survey(written(tmp_path, text, "a.csv"))


def test_a_file_is_told_by_what_stands_in_it(tmp_path: Path) -> None:
    gsi = "*110001+000000000000A-LL 81..46+0000000004137033 82..46+0000000001906996 83..46+0000000000116112 \n"
    for name in ("a.csv", "a.txt", "a.gsi"):
        assert_allclose(read_survey(written(tmp_path, gsi, name)).require("A-LL").position, PLACES["A-LL"])


def test_a_survey_states_its_columns(lab: Path) -> None:
    folder = lab / "truth"
    expected = read_surveyed_truth(lab)
    rows = [row.split(",") for row in (folder / "survey.csv").read_text().splitlines()[1:]]
    (folder / "points.txt").write_text("\n".join(f"{name}\t{y}\t{x}\t{z}" for name, x, y, z in rows))
    plan = yaml.safe_load((folder / "survey.yaml").read_text())
    for columns in ("P,N,E,H", ["P", "N", "E", "H"]):
        (folder / "survey.yaml").write_text(yaml.safe_dump(plan | {"file": "points.txt", "columns": columns}))
        for stop, other in zip(read_surveyed_truth(lab).stops, expected.stops, strict=True):
            for pose, there in zip(stop.poses, other.poses, strict=True):
                assert_allclose(
                    pose.forklift_from_pallet.as_array(), there.forklift_from_pallet.as_array(), atol=1e-12
                )
    (folder / "survey.yaml").write_text(yaml.safe_dump(plan | {"file": "points.txt"}))
    assert read_surveyed_truth(lab, ("P", "N", "E", "H")).stops[0].name == "S1"
    with pytest.raises(SurveyError, match=r"points\.txt, line 1: no header"):
        read_surveyed_truth(lab)
    exchanged = ("P", "E", "N", "H")
    with pytest.raises(SurveyError, match=r"mirror|exchanged|left-handed"):
        read_surveyed_truth(lab, exchanged)
