"""What `palletloc simulate` refuses: options that are no numbers, or beyond what a scene can hold."""

from pathlib import Path

import pytest

from palletloc.cli.app import run

BEYOND = [
    ("--level", "nan"),
    ("--level", "inf"),
    ("--level", "1e9"),
    ("--level", "-1"),
    ("--shots", "1000000000"),
    ("--shots", "0"),
    ("--width", "1000000"),
    ("--blur", "nan"),
    ("--noise", "-inf"),
    ("--gain", "0"),
    ("--gloss", "nan"),
    ("--occluders", "1000000000"),
    ("--seed", "x"),
    ("--light", "moon"),
]
"""Options and values that make no scene."""


@pytest.mark.parametrize(("option", "value"), BEYOND, ids="=".join)
def test_an_option_beyond_reason_is_wrong_usage_and_writes_nothing(
    option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(["simulate", "--out", str(out), option, value]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert option in said.err
    assert "Traceback" not in said.err
    assert not out.exists()
