import json
import subprocess
import sys
from pathlib import Path

import pytest

EVERY = [word for name in ("horizontal_plane", "paper", "joint_search") for word in ("--method", name)]
SCENES = ["--consistency", "2", "--shots", "1", "--width", "640", *EVERY]
ROOT = Path(__file__).resolve().parents[1]


pytestmark = pytest.mark.slow


def printed(*options: str) -> str:
    command = [sys.executable, "-m", "benchmarks", "--rounds", "1", "--json", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("options", [[], ["--accuracy"], SCENES], ids=["speed", "accuracy", "consistency"])
def test_the_benchmarks_run_and_print_json(options: list[str]) -> None:
    text = printed(*options)
    assert json.loads(text)
    for method in ("horizontal_plane", "paper", "joint_search"):
        assert method in text


@pytest.mark.parametrize(
    ("part", "goals"), [("--tracking", [60.0, 60.0, 60.0, 3.0, 15.0, None]), ("--evaluation", [None, 0.6, None, 0.6])]
)
def test_costs_of_tracking_and_evaluation_are_printed_beside_goals(part: str, goals: list[float | None]) -> None:
    if part == "--evaluation":
        pytest.importorskip("distributed")
    (section,) = json.loads(printed(part))
    assert [row["goal"] for row in section["rows"]] == goals
    assert all(row["median"] > 0 for row in section["rows"])
