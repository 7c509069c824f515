import re
from pathlib import Path

import pytest

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def printed(example: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    exec(compile(example, "README.md", "exec"), {})
    return capsys.readouterr().out.splitlines()


def test_the_streaming_example_confirms_every_pallet(capsys: pytest.CaptureFixture[str]) -> None:
    example = EXAMPLES[1]
    lines = printed(example, capsys)
    assert len(lines) >= 2
    assert all(re.fullmatch(r"[\d.]+ s track \d: [-\d. ]+ m, exact", line) for line in lines)


def test_the_python_example_prints_a_line_per_pallet_and_shot(capsys: pytest.CaptureFixture[str]) -> None:
    example = EXAMPLES[0]
    lines = printed(example, capsys)
    assert len(lines) >= 11
    assert all(re.fullmatch(r"[\d.]+ s t11-plastic: [-\d. ]+ m, [-\d.]+ rad", line) for line in lines)


def test_every_file_that_is_linked_exists() -> None:
    targets = re.findall(r"\]\(([^)#:]+)\)", README)
    assert len(targets) > 10
    root = Path(__file__).resolve().parents[1]
    assert [target for target in targets if not (root / target).exists()] == []
