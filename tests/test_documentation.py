"""What the pages say about the program, compared with the program."""

import importlib
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
import yaml

import calibration
import palletloc
import tracking
from palletloc import LocalizerConfig, Method
from palletloc.__main__ import COMMANDS
from palletloc.cli.app import Command
from palletloc.evaluation.recording import ERROR_COLUMNS
from palletloc.io.config_file import read_config
from palletloc.io.tracks import TRACK_COLUMNS
from palletloc.measurement import Reason, Stage
from tracking.config import read_tracker_config
from tracking.events import EventKind
from tracking.files import EVENT_COLUMNS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PIPELINE = (DOCS / "pipeline.md").read_text(encoding="utf-8")
RESULTS = (DOCS / "results.md").read_text(encoding="utf-8")
REFUSALS = (DOCS / "refusals.md").read_text(encoding="utf-8")
API = (DOCS / "api.md").read_text(encoding="utf-8")
CLI = (DOCS / "cli.md").read_text(encoding="utf-8")
COMMON = {"--help", "--json", "--quiet"}
"""Options of every command; they are described above the commands."""
SECTIONS = {field.name for field in fields(LocalizerConfig)}


def sections(page: str, mark: str) -> dict[str, str]:
    """Return the text below each heading of one level."""
    pieces = re.split(rf"^{mark} (.+)\n", page, flags=re.MULTILINE)
    return dict(zip(pieces[1::2], pieces[2::2], strict=True))


def spellings(option: Any) -> list[str]:
    """Return what may be typed for an option, and for its opposite."""
    return [*option.opts, *option.secondary_opts]


def long_options(command: Command) -> set[str]:
    """Return the long options of a command, or of all commands below it."""
    loaded = command.load()
    if isinstance(loaded, typer.Typer):
        below = typer.main.get_group(loaded).commands.values()
    else:
        app = typer.Typer(add_completion=False)
        app.command()(loaded)
        below = {"": typer.main.get_command(app)}.values()
    return {name for leaf in below for option in leaf.params for name in spellings(option) if name[:2] == "--"}


def test_every_reason_is_explained_with_cause_and_remedy_and_every_stage_has_a_row() -> None:
    assert sorted(re.findall(r"^### (.+)$", REFUSALS, re.MULTILINE)) == sorted(Reason)
    rows = re.findall(r"^\| `(\w+)` \|", sections(REFUSALS, "##")["Stages"], re.MULTILINE)
    assert rows == [str(stage) for stage in Stage]
    for reason in Reason:
        text = sections(REFUSALS, "###")[reason]
        meaning, *points = re.split(r"^- ", text.strip(), flags=re.MULTILINE)
        assert meaning.strip().endswith("."), reason
        assert [point.split(":")[0] for point in points] == ["**Cause", "**Remedy"], reason


@pytest.mark.parametrize("page", [REFUSALS + CLI, PIPELINE], ids=["refusals", "pipeline"])
def test_every_parameter_that_is_named_exists(page: str) -> None:
    for section, name in re.findall(r"`(\w+)\.(\w+)`", page):
        if section in SECTIONS:
            part = getattr(LocalizerConfig(), section)
            assert is_dataclass(part)
            assert name in {field.name for field in fields(part)}, f"{section}.{name}"


def test_parameters_are_named_where_they_help() -> None:
    assert len(re.findall(r"`(?:detection|yaw|position|verification|prior)\.\w+`", REFUSALS)) > 5
    assert len([section for section, _ in re.findall(r"`(\w+)\.(\w+)`", PIPELINE) if section in SECTIONS]) > 20


def test_every_command_has_a_section_with_its_options_and_no_others() -> None:
    assert set(sections(CLI, "##")) == {f"palletloc {command.name}" for command in COMMANDS}
    for command in COMMANDS:
        rows = re.findall(r"^\| (.*?) \|", sections(CLI, "##")[f"palletloc {command.name}"], re.MULTILINE)
        described = set(re.findall(r"--[a-z]+(?:-[a-z]+)*", " ".join(rows)))
        assert described == long_options(command) - COMMON, command.name
        assert long_options(command) >= {"--json", "--quiet"}
    assert set(re.findall(r"^\| `(--\w+)`", CLI.split("\n## ")[0], re.MULTILINE)) == COMMON


def test_every_method_is_named() -> None:
    row = next(line for line in CLI.splitlines() if line.startswith("| `--method"))
    assert set(re.findall(r"`(\w+)`", row)) == {str(method) for method in Method}


def test_the_example_of_a_file_of_parameters_can_be_read(tmp_path: Path) -> None:
    example = re.findall(r"^```yaml\n(.*?)^```", CLI, re.MULTILINE | re.DOTALL)[-1]
    path = tmp_path / "mine.yaml"
    path.write_text(example)
    config = read_config(path)
    assert config != LocalizerConfig()
    assert config.detection.max_range == yaml.safe_load(example)["detection"]["max_range"]
    hits = read_tracker_config(path).life.confirm_hits
    assert hits == yaml.safe_load(example)["tracker"]["life"]["confirm_hits"]


def test_the_columns_of_every_table_and_every_event_are_listed() -> None:
    lines = (DOCS / "files.md").read_text(encoding="utf-8").splitlines()
    assert [
        name for name in (TRACK_COLUMNS, EVENT_COLUMNS, ERROR_COLUMNS) if f"`{','.join(name)}`" not in lines
    ] == []
    (section,) = re.findall(
        r"^### events.csv\n(.*?)^##", (DOCS / "files.md").read_text(encoding="utf-8"), re.M | re.S
    )
    _, rows = section.split("| `event` | means |")
    explained = [cell for row in rows.splitlines() for cell in re.findall(r"`(\w+)`", row.rpartition(" | ")[0])]
    assert sorted(explained) == sorted(EventKind)


@pytest.mark.parametrize("package", [palletloc, tracking, calibration], ids=lambda package: package.__name__)
def test_every_public_name_is_listed_with_the_first_line_of_its_docstring(package: ModuleType) -> None:
    first = {name: " ".join(str(getattr(package, name).__doc__).split("\n\n")[0].split()) for name in package.__all__}
    (section,) = (text for title, text in sections(API, "##").items() if f"`{package.__name__}`" in title)
    assert dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", section, re.MULTILINE)) == first


def test_modules_plots_and_steps_with_parameters_are_described_and_exist() -> None:
    named = set(re.findall(r"`(palletloc(?:\.\w+)+)`", PIPELINE))
    assert len(named) > 20
    assert [name for name in sorted(named) if not importlib.import_module(name).__doc__] == []
    described = {section for section, _ in re.findall(r"`(\w+)\.(\w+)`", PIPELINE)}
    assert described >= SECTIONS - {"joint_search"}
    scripts = re.findall(r"^\.\. plot:: (\S+)$", PIPELINE, re.MULTILINE)
    assert scripts
    assert all((DOCS / script).is_file() for script in scripts)


def test_every_method_has_its_row_in_every_table_of_accuracy() -> None:
    tables = [table for table in re.findall(r"(?:^\|.*\n)+", RESULTS, re.MULTILINE) if "| method |" in table]
    assert tables
    for table in tables:
        assert set(re.findall(r"\| (\w+) \| \d+ \|", table)) == {str(method) for method in Method}


README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def printed(example: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    exec(compile(example, "README.md", "exec"), {})
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize(
    ("number", "least", "line"),
    [(0, 11, r"[\d.]+ s t11-plastic: [-\d. ]+ m, [-\d.]+ rad"), (1, 2, r"[\d.]+ s track \d: [-\d. ]+ m, exact")],
    ids=["shots", "streaming"],
)
def test_each_python_example_of_the_readme_prints_a_line_per_pallet(
    number: int, least: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = printed(EXAMPLES[number], capsys)
    assert len(lines) >= least
    assert all(re.fullmatch(line, printed_line) for printed_line in lines)


def test_every_file_that_is_linked_exists() -> None:
    targets = re.findall(r"\]\(([^)#:]+)\)", README)
    assert len(targets) > 10
    assert [target for target in targets if not (ROOT / target).exists()] == []
