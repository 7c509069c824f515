import json
import subprocess
import sys
from pathlib import Path

import pytest

EVERY = [word for name in ("horizontal_plane", "paper", "joint_search") for word in ("--method", name)]
SCENES = ["--consistency", "2", "--shots", "1", "--width", "640", *EVERY]
ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--accuracy"], SCENES], ids=["speed", "accuracy", "consistency"])
def test_the_benchmarks_run_and_print_json(options: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--rounds", "1", "--json", *options],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    for method in ("horizontal_plane", "paper", "joint_search"):
        assert method in done.stdout


@pytest.mark.slow
def test_the_cost_of_tracking_is_printed_beside_its_goals() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--tracking", "--rounds", "1", "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (section,) = json.loads(done.stdout)
    assert [row["goal"] for row in section["rows"]] == [60.0, 60.0, 60.0, 3.0, 15.0, None]
    assert all(row["median"] > 0 for row in section["rows"])


@pytest.mark.slow
def test_evaluation_in_parallel_is_printed_beside_its_goal() -> None:
    pytest.importorskip("distributed")
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--evaluation", "--rounds", "1", "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (section,) = json.loads(done.stdout)
    assert [row["goal"] for row in section["rows"]] == [None, 0.6, None, 0.6]
    assert all(row["median"] > 0 for row in section["rows"])
