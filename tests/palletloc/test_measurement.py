from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path

import pytest

from palletloc.measurement import Reason, Stage, YawSource


def test_the_sources_of_yaw_are_those_that_files_may_name() -> None:
    assert {str(source) for source in YawSource} == {
        "bottom",
        "top",
        "opening_top",
        "opening_bottom",
        "face",
    }


@pytest.mark.parametrize("codes", [Stage, Reason, YawSource])
def test_codes_are_words_that_a_file_can_hold(codes: type[StrEnum]) -> None:
    for code in codes:
        assert str(code) == code.name.lower()
        assert codes(str(code)) is code


def test_every_stage_and_reason_is_documented() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "refusals.md").read_text(encoding="utf-8")
    stages = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    reasons = re.findall(r"^### (\w+)$", page, re.MULTILINE)
    assert sorted(stages) == sorted(Stage)
    assert sorted(reasons) == sorted(Reason)
