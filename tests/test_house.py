"""The house's own rules: sizes, commands that stand in several places, and how the program fails."""

import re
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
import typer
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import palletloc
from palletloc import PalletLocError
from palletloc.__main__ import COMMANDS, main
from palletloc.cli.app import COMMANDS as OWN_COMMANDS
from palletloc.cli.app import Command, run

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("palletloc", "tracking", "calibration")
MAX_LINES = 350
HEAVY = {"cv2", "matplotlib", "numpy", "pydantic", "scipy", "skimage", "yaml"}


def own_files(*suffixes: str) -> list[Path]:
    folders = (*PACKAGES, "tests", "docs", "examples", "benchmarks", ".ci")
    found = [path for folder in folders for path in sorted((ROOT / folder).rglob("*"))]
    made = {"_build", "gallery", "api", "__pycache__"}
    return [path for path in found if path.suffix in suffixes and not made & set(path.parts)]


def shell_lines(page: Path) -> list[str]:
    blocks = re.findall(r"^```(?:sh|bash|console)\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    lines = [line.removeprefix("$ ").split("#")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


# Commands that stand for what the frame has to deal with; `Command` finds them here by name.


def refuses() -> None:
    """Refuse."""
    raise PalletLocError("shots.csv, line 3: 'time_s' is\nnot a number")


def cannot_read() -> None:
    """Read a file that is not there."""
    Path("no/such/file.csv").read_text()


def is_interrupted() -> None:
    """Take too long."""
    raise KeyboardInterrupt


def succeeds() -> None:
    """Do nothing."""


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[Command]:
    monkeypatch.setitem(sys.modules, "house_commands", sys.modules[__name__])
    functions = (refuses, cannot_read, is_interrupted, succeeds)
    rows = [Command(f.__name__.replace("_", "-"), f"house_commands:{f.__name__}", f.__doc__ or "") for f in functions]
    return [*rows, Command("absent", "palletloc.no_such_module:absent", "Not there.")]


def test_no_file_has_more_than_350_lines() -> None:
    lines = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8").count("\n") for path in own_files(".py")}
    assert lines
    assert {name: count for name, count in lines.items() if count > MAX_LINES} == {}


def test_the_version_stands_once_is_printed_and_the_newest_in_the_changelog() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    versions = re.findall(r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert palletloc.__version__ == project["version"] == versions[0]
    command = [sys.executable, "-m", "palletloc", "--version"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert ended.stdout == f"palletloc {palletloc.__version__}\n"


def test_every_package_says_that_it_is_typed() -> None:
    assert [package for package in PACKAGES if not (ROOT / package / "py.typed").is_file()] == []


def test_the_readme_sets_up_and_tests_as_the_makefile_does() -> None:
    lines = shell_lines(ROOT / "README.md")
    makefile = (ROOT / "Makefile").read_text()
    assert {"make demo", "make test"} <= set(lines)
    installs = [line for line in lines if "pip install" in line]
    assert installs
    assert all("--constraint constraints.txt" in line for line in installs)
    assert "CONSTRAINTS ?= constraints.txt" in makefile
    for extras in re.findall(r"\[([a-z,]+)\]", " ".join(installs)):
        assert re.search(rf"extras = {extras}$", makefile, re.MULTILINE)
    for line in lines:
        if "pytest" in line or line == "palletloc demo":
            assert f"$(BIN)/{line}" in makefile


def test_every_make_target_that_is_named_exists() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    target = re.compile(r"\bmake ([a-z]+)\b(?=[`\s]*(?:$|[`#,;.]| VENV))", re.MULTILINE)
    for page in ("README.md", "CONTRIBUTING.md", "docs/install.md", ".ci/run"):
        named = set(target.findall((ROOT / page).read_text()))
        assert named, page
        assert named - targets == set(), page


def test_the_list_of_commands_says_what_the_commands_say_themselves() -> None:
    for command in dict.fromkeys((*COMMANDS, *OWN_COMMANDS)):
        loaded = command.load()
        text = loaded.info.help if isinstance(loaded, typer.Typer) else loaded.__doc__
        assert isinstance(text, str)
        assert text.strip().splitlines()[0] == command.summary


def test_bad_input_is_one_line_and_exit_code_1(commands: list[Command], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["refuses"], commands) == 1
    assert capsys.readouterr() == ("", "palletloc: shots.csv, line 3: 'time_s' is not a number\n")
    assert run(["cannot-read"], commands) == 1
    assert capsys.readouterr().err == f"palletloc: {Path('no/such/file.csv')}: No such file or directory\n"


def test_verbose_adds_where_it_happened(
    commands: list[Command], caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["--verbose", "refuses"], commands) == 1
    assert capsys.readouterr().err.startswith("palletloc: shots.csv")
    assert [record.exc_info is not None for record in caplog.records] == [True]


def test_an_interrupt_is_one_line_and_code_130(commands: list[Command], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["is-interrupted"], commands) == 130
    assert capsys.readouterr() == ("", "palletloc: interrupted\n")


def test_wrong_usage_is_exit_code_2_and_success_0_and_needs_no_other_command(commands: list[Command]) -> None:
    for arguments in (["no-such-command"], ["--no-such-option"], ["succeeds", "more"], []):
        assert run(arguments, commands) == 2
    assert run(["succeeds"], commands) == 0
    assert run(["--help"], commands) == 0


def test_a_fault_of_the_program_is_not_taken_for_bad_input(commands: list[Command]) -> None:
    with pytest.raises(ModuleNotFoundError):
        run(["absent"], commands)


def test_the_program_exits_with_the_code_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["palletloc", "no-such-command"])
    with pytest.raises(SystemExit) as ending:
        main()
    assert ending.value.code == 2


def after_help(*command: str) -> tuple[list[str], set[str]]:
    """Return the lines of a help, and the modules that were imported for it."""
    code = f"import sys; sys.argv[1:] = {[*command, '--help']}; from palletloc.__main__ import main\n"
    code += "try: main()\nfinally: print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    *listing, modules = ended.stdout.splitlines()
    return listing, set(modules.split())


def test_help_lists_every_command_and_imports_nothing_heavy() -> None:
    listing, modules = after_help()
    assert all(any(f" {command.name} " in line for line in listing) for command in COMMANDS)
    assert modules & (HEAVY | {"rich.markdown", "rich.traceback"}) == set()


@pytest.mark.parametrize("name", [command.name for command in COMMANDS])
def test_the_help_of_a_command_imports_nothing_that_the_command_works_with(name: str) -> None:
    _, modules = after_help(name)
    assert modules & (HEAVY - {"pydantic"}) == set()  # newer releases of typer import pydantic themselves


def test_the_constraints_hold_a_version_within_the_bounds_for_every_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    pinned = [Requirement(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if line[:1] != "#"]
    for python in ("3.11", "3.12", "3.13"):
        versions = {
            canonicalize_name(pin.name): next(iter(pin.specifier)).version
            for pin in pinned
            if pin.marker is None or pin.marker.evaluate({"python_version": python})
        }
        for needed in map(Requirement, declared):
            assert versions[canonicalize_name(needed.name)] in needed.specifier, (python, needed.name)
