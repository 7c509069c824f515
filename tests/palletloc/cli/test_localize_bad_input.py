import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from palletloc.cli.app import run

Localize = Callable[..., int]
Refused = Callable[..., str]
Status = Callable[[], dict[str, Any]]

LOCALIZE = ["localize", "approach", "--out", "out"]
pytestmark = pytest.mark.usefixtures("here")


def edit(name: str, old: str, new: str) -> None:
    path = Path("approach", name)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def huge_png() -> bytes:
    """Return the beginning of an image of 30 000 x 30 000 pixels."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


def png(width: int, height: int) -> bytes:
    noise = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return cv2.imencode(".png", noise)[1].tobytes()


IMAGES: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "no such file"),
    "empty": (b"", "is empty; expected a JPEG or PNG image"),
    "text": (b"nothing", "is not a JPEG or PNG image, or is cut off before its size"),
    "truncated": (png(64, 32)[:-2000], "is truncated or damaged; expected all of the image"),
    "other size": (png(32, 64), "is 32 x 64 px, the camera is 64 x 32 px"),
    "huge": (huge_png(), "is 30000 x 30000 px; expected at most 16384 px a side and 134217728 px in all"),
}


def put(number: int, content: bytes | None) -> str:
    """Put an image into the recording, and return its name."""
    path = Path("approach", "images", f"{number}.png")
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    return str(path)


@pytest.mark.parametrize("kind", IMAGES)
@pytest.mark.parametrize("number", [0, 2])
def test_an_unreadable_shot_is_one_line_and_the_rest_is_done(
    localize: Localize, status: Status, kind: str, number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    content, problem = IMAGES[kind]
    line = f"{put(number, content)}: {problem}"
    assert localize() == 0
    printed = capsys.readouterr()
    assert printed.err == f"palletloc: skipped: {line}\n"
    assert ["skipped", "1"] in [row.split() for row in printed.out.splitlines()]
    assert (status()["complete"], status()["done"]) == (True, 3)
    file = f"images/{number}.png"
    assert status()["skipped"] == [{"time_s": 0.5 * number, "file": file, "reason": line}]


@pytest.mark.parametrize("kind", IMAGES)
def test_strict_stops_at_an_unreadable_shot(refused: Refused, kind: str) -> None:
    content, problem = IMAGES[kind]
    path = put(0, content)
    assert refused(*LOCALIZE, "--strict") == f"{path}: {problem}"
    assert not Path("out").exists()


def test_a_camera_of_another_size_is_one_line_and_leaves_nothing(refused: Refused) -> None:
    edit("recording.yaml", "width: 64, height: 32", "width: 32, height: 16")
    first = f"{Path('approach/images/0.png')}: is 64 x 32 px, the camera is 32 x 16 px"
    assert refused(*LOCALIZE) == f"approach: none of 4 shots can be used; the first: {first}"
    assert not Path("out").exists()


BAD = [
    ("recording.yaml", "format: 1", "format: 2", "recording.yaml: format: "),
    ("recording.yaml", "shelf:", "shelv:", "recording.yaml: unknown key 'shelv'; did you mean 'shelf'?"),
    ("recording.yaml", "[0, 0, 0]", "[0, .nan, 0]", "recording.yaml: forklift_from_camera.roll_pitch_yaw"),
    ("recording.yaml", "[t11]", "[t12]", "recording.yaml: pallets: unknown pallet model 't12'; did you"),
    ("recording.yaml", "[3.0, 2.0]", "[3.0, -0.1]", "recording.yaml: shelf: at the first shot the camera is on"),
    ("recording.yaml", "-90.0", "90.0", "recording.yaml: shelf: at the first shot the camera is behind"),
    ("recording.yaml", "[0.0]", "[.inf]", "recording.yaml: shelf.levels_m[0]: expected a finite number"),
    ("shots.csv", "0.5,images", "half,images", "shots.csv, line 3: time_s: expected a finite number, got 'half'"),
    ("shots.csv", "1.5,images", "1.0,images", "shots.csv, line 5: time_s: 1.0 repeats 1.0 of line 4; expected"),
    ("shots.csv", "1.0,images", "0.1,images", "shots.csv, line 4: time_s: 0.1 is earlier than 0.5 of line 3"),
    ("shots.csv", "time_s,file", "time,file", "shots.csv, line 1: unknown column 'time'; did you mean 'time_s'?"),
    ("odometry.csv", "0.8,0.0", "0.8,nan", "odometry.csv, line 4: y_m: expected a finite number, got 'nan'"),
    ("odometry.csv", "0.2,0.4,0.1", "0.2,0.4", "odometry.csv, line 4: expected 6 cells, got 5"),
]


@pytest.mark.parametrize(("name", "old", "new", "problem"), BAD, ids=lambda value: value[:24])
def test_a_bad_recording_is_one_line_and_leaves_nothing(
    refused: Refused, name: str, old: str, new: str, problem: str
) -> None:
    edit(name, old, new)
    assert refused(*LOCALIZE).startswith(str(Path("approach", problem)))
    assert not Path("out").exists()


@pytest.mark.parametrize("name", ["recording.yaml", "shots.csv", "odometry.csv"])
def test_a_missing_file_is_one_line(refused: Refused, name: str) -> None:
    Path("approach", name).unlink()
    assert refused(*LOCALIZE) == f"{Path('approach', name)}: no such file"


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["none", "--out", "out"], "none: no such folder; expected a recording with recording.yaml in it"),
        (["approach/shots.csv", "--out", "out"], "no such folder; expected a recording"),
        (["approach", "--out", "approach/shots.csv"], "shots.csv: cannot be written: "),
        (["approach", "--out", "out", "--config", "none.yaml"], "none.yaml: no such file"),
        (["approach", "--out", "out", "--config", "approach/shots.csv"], "shots.csv: expected the keys prior"),
        (["approach", "--out", "out", "--initial", "none.csv"], "none.csv: no such file"),
        (["approach", "--out", "out", "--initial", "approach/shots.csv"], "shots.csv, line 1: unknown column"),
    ],
)
def test_a_bad_argument_is_one_line_and_leaves_nothing(
    here: Path, refused: Refused, arguments: list[str], problem: str
) -> None:
    before = sorted(here.rglob("*"))
    assert problem in refused("localize", *arguments)
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize("options", [["--method", "guess"], ["--shot", "1"], ["more"]])
def test_wrong_usage_is_exit_code_2(localize: Localize, options: list[str]) -> None:
    assert localize(*options) == 2
    assert run(["localize", "approach"]) == 2
    assert run(["localize", "--out", "out"]) == 2


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("t11,4", "t1,4", "line 3: model: the recording's pallets do not include 't1'; did you mean 't11'?"),
        ("t11,4", "t11,nan", "line 3: x_m: expected a finite number, got 'nan'"),
        ("0.0,t11", "0.2,t11", "line 4: time_s: no shot at 0.2 s; the nearest is at 0 s"),
        ("0,1.5\n0.0", "0\n0.0", "line 3: expected 6 cells, got 5"),
    ],
)
def test_a_bad_start_is_one_line(refused: Refused, old: str, new: str, problem: str) -> None:
    edit("../initial.csv", old, new)
    assert refused(*LOCALIZE, "--initial", "initial.csv") == f"initial.csv, {problem}"
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ("3000,2000,0,1.5", "out_of_range (4), 100 m and farther away: millimetres?"),
        ("3,2,0,-1.5", "behind_face (4)"),
    ],
)
def test_starts_of_which_none_can_be_tried_end_with_exit_1(
    localize: Localize, capsys: pytest.CaptureFixture[str], start: str, said: str
) -> None:
    rows = [f"{0.5 * number},t11,{start}" for number in range(4)]
    Path("starts.csv").write_text("\n".join(["time_s,model,x_m,y_m,z_m,yaw_rad", *rows]))
    assert localize("--initial", "starts.csv") == 1
    assert capsys.readouterr().err == f"palletloc: --initial: none of 4 starts can be used: {said}\n"
    assert len(Path("out/measurements.csv").read_text().splitlines()) == 5  # a row out per row in, all the same
