from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import LevelPose
from palletloc.search_axes import SearchAxes

BASE = LevelPose(2.0, 1.5, 0.1, 1.4)
AXES = SearchAxes(BASE, 2.5, 1.8)
DEPTH = np.array([np.cos(BASE.yaw), np.sin(BASE.yaw)])
ALONG = np.array([-DEPTH[1], DEPTH[0]])


def moved(along_ray: float = 0.0, sideways: float = 0.0, turn: float = 0.0) -> LevelPose:
    """Return the base moved along a viewing ray on the ground that meets the face at an angle, and sideways."""
    obliquely = np.sqrt(AXES.away**2 - AXES.depth**2) / AXES.depth
    step = along_ray * AXES.depth / AXES.away * (DEPTH + obliquely * ALONG) + sideways * ALONG
    return replace(BASE, x=BASE.x + step[0], y=BASE.y + step[1], yaw=BASE.yaw + turn)


def test_the_base_is_in_its_place() -> None:
    assert AXES.place(BASE) == pytest.approx([BASE.yaw, 2.5])


@given(st.floats(-1.0, 1.0), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))
def test_a_step_along_the_ray_changes_the_distance_and_one_sideways_does_not(
    along_ray: float, sideways: float, turn: float
) -> None:
    yaw, away = AXES.place(moved(along_ray, sideways, turn))
    assert yaw - BASE.yaw == pytest.approx(turn, abs=1e-9)
    assert away == pytest.approx(2.5 + along_ray)


def test_a_yaw_across_the_seam_stays_next_to_the_bases() -> None:
    axes = replace(AXES, base=replace(BASE, yaw=3.1))
    assert axes.place(replace(BASE, yaw=-3.1))[0] == pytest.approx(2 * np.pi - 3.1)


def test_the_covariance_is_that_of_moved_places() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(4, 4)) * 1e-3
    drawn = BASE.as_array() + rng.normal(size=(20_000, 4)) @ factor.T
    places = np.array([AXES.place(LevelPose(*row)) for row in drawn])
    assert AXES.covariance(factor @ factor.T) == pytest.approx(np.cov(places.T), rel=0.06, abs=2e-7)


def test_turns_and_factors_become_yaws_and_distances() -> None:
    assert AXES.yaws(np.array([-0.1, 0.2])) == pytest.approx([1.3, 1.6])
    assert AXES.ranges(np.array([0.9, 1.2])) == pytest.approx([2.25, 3.0])
