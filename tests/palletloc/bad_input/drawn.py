"""How bad input is drawn, and the types of what it is tried on."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import Phase, settings

from palletloc import ShelfPlane, Shot
from tests.palletloc.poses import Pallets

Scene = tuple[Shot, Pallets, ShelfPlane]
"""A shot, the pallets in it and the nominal shelf plane."""
Scenes = Callable[[str], Scene]
Faults = Callable[..., list[str]]
Check = Callable[..., Any]
NAMES = ["floor", "rack", "fisheye", "pinhole"]
HEIGHTS = pytest.mark.parametrize(
    "known",
    [True, pytest.param(True, marks=pytest.mark.slow), pytest.param(False, marks=pytest.mark.slow)],
    ids=["level", "level-many", "free"],
)
"""Whether the levels are known; more examples are drawn with the slow tests."""


def few(percent: int) -> settings:
    """Return settings that draw so many percent of the usual count of examples, and do not look for simpler ones."""
    return settings(max_examples=settings().max_examples * percent // 100, phases=[Phase.generate])
