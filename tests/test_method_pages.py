"""What the pages about the method name, compared with the program."""

from __future__ import annotations

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path

from palletloc.choices import Method
from palletloc.config import LocalizerConfig

DOCS = Path(__file__).resolve().parents[1] / "docs"
PIPELINE = (DOCS / "pipeline.md").read_text(encoding="utf-8")
RESULTS = (DOCS / "results.md").read_text(encoding="utf-8")
SECTIONS = {field.name for field in fields(LocalizerConfig)}


def test_every_module_that_is_named_exists() -> None:
    named = set(re.findall(r"`(palletloc(?:\.\w+)+)`", PIPELINE))
    assert len(named) > 20
    assert [name for name in sorted(named) if not importlib.import_module(name).__doc__] == []


def test_parameters_that_are_named_exist() -> None:
    named = [pair for pair in re.findall(r"`(\w+)\.(\w+)`", PIPELINE) if pair[0] in SECTIONS]
    assert len(named) > 20
    for section, name in named:
        part = getattr(LocalizerConfig(), section)
        assert is_dataclass(part)
        assert name in {field.name for field in fields(part)}, f"{section}.{name}"


def test_every_step_with_parameters_is_described() -> None:
    described = {section for section, _ in re.findall(r"`(\w+)\.(\w+)`", PIPELINE)}
    assert described >= SECTIONS - {"joint_search"}


def test_every_method_has_its_row_in_every_table_of_accuracy() -> None:
    tables = [table for table in re.findall(r"(?:^\|.*\n)+", RESULTS, re.MULTILINE) if "| method |" in table]
    assert tables
    for table in tables:
        assert set(re.findall(r"\| (\w+) \| \d+ \|", table)) == {str(method) for method in Method}


def test_every_plot_has_its_script() -> None:
    scripts = re.findall(r"^\.\. plot:: (\S+)$", PIPELINE, re.MULTILINE)
    assert scripts
    assert all((DOCS / script).is_file() for script in scripts)
