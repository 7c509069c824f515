"""The versions of all dependencies that an installation is tried with.

``constraints.py INTERPRETER... > constraints.txt`` installs the newest releases with each interpreter, each in an
environment of its own, and prints their exact versions: once, or with the Python that they are for.
``constraints.py`` prints the lowest versions that pyproject.toml declares.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = "batch,dev,docs,test"


def lowest() -> list[str]:
    """Return the lowest version of each dependency that is needed to run and to test."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    declared = {*project["dependencies"], *extras["batch"], *extras["test"]}
    return sorted(each.replace(">=", "==") for each in declared)


def newest(interpreter: str) -> tuple[str, dict[str, str]]:
    """Return an interpreter's version of Python, and of each package what it installs today."""
    with TemporaryDirectory() as folder:
        python = Path(folder) / "bin" / "python"
        subprocess.run([interpreter, "-m", "venv", folder], check=True)
        pip = [str(python), "-m", "pip", "--disable-pip-version-check"]
        subprocess.run([*pip, "install", "--quiet", f"{ROOT}[{EXTRAS}]"], check=True, stdout=sys.stderr)
        frozen = subprocess.run([*pip, "freeze"], check=True, capture_output=True, text=True).stdout
        code = "import sys; print('.'.join(map(str, sys.version_info[:2])))"
        version = subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True).stdout
    rows = (line.partition("==") for line in frozen.splitlines())
    return version.strip(), {name: number for name, equal, number in rows if equal}


def merged(installed: dict[str, dict[str, str]]) -> list[str]:
    """Return one line for each package and version, with the Pythons it is for where they are not all."""
    pythons = defaultdict[tuple[str, str], list[str]](list)
    for python, packages in installed.items():
        for package in packages.items():
            pythons[package].append(python)
    lines = []
    for (name, number), those in sorted(pythons.items(), key=lambda row: (row[0][0].lower(), row[1])):
        marker = "" if len(those) == len(installed) else f'; python_version in "{" ".join(those)}"'
        lines.append(f"{name}=={number}{marker}")
    return lines


if __name__ == "__main__":
    interpreters = sys.argv[1:]
    if interpreters:
        print("# Made by `make constraints`: the versions that the tests are run with.")
    print(*(merged(dict(map(newest, interpreters))) if interpreters else lowest()), sep="\n")
