from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import Reason, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.horizontal_view import BoundaryMethod, HorizontalView, YawConfig, view_horizontal
from palletloc.paper.yaw import YawEstimate, find_lines, measure_line, measure_yaw
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
HIGH = replace(POSE, z=3.3)
CONFIG = YawConfig()
Portrait = Callable[..., Shot]


def viewed(shot: Shot, model: PalletModel, start: LevelPose, source: YawSource) -> HorizontalView:
    return view_horizontal(shot, start, model, source, CONFIG)


def measured(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, source: YawSource = YawSource.BOTTOM
) -> YawEstimate:
    """The yaw, with the plane placed again by the first result."""
    first = measured_once(shot, model, start, source)
    return measured_once(shot, model, replace(start, yaw=first.yaw), source)


def measured_once(shot: Shot, model: PalletModel, start: LevelPose, source: YawSource) -> YawEstimate:
    found = measure_yaw(shot, viewed(shot, model, start, source), start, model, CONFIG)
    assert isinstance(found, YawEstimate)
    return found


def turned(pose: LevelPose, turn_deg: float) -> LevelPose:
    return replace(pose, yaw=pose.yaw + np.radians(turn_deg))


def slid(shot: Shot, pose: LevelPose, factor: float) -> LevelPose:
    x, y, z = shot.mounting.center + factor * (np.array([pose.x, pose.y, pose.z]) - shot.mounting.center)
    return replace(pose, x=x, y=y, z=z)


@pytest.mark.parametrize("yaw_deg", [-6.0, 1.1, 5.0])
@pytest.mark.parametrize("x", [0.3, 1.8])
def test_the_yaw_of_a_pallet_on_the_floor_is_within_three_sigma(
    model: PalletModel, yaw_deg: float, x: float, portrait: Portrait
) -> None:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2 + np.radians(yaw_deg))
    found = measured(portrait(model, pose), model, pose)
    assert abs(found.yaw - pose.yaw) < 3 * found.sigma
    assert found.sigma < np.radians(1.0)
    assert found.source in (YawSource.BOTTOM, YawSource.OPENING_TOP, YawSource.OPENING_BOTTOM)


def test_above_the_camera_the_upper_edges_give_the_yaw(portrait: Portrait, epal: PalletModel) -> None:
    found = measured(portrait(epal, HIGH), epal, HIGH, YawSource.TOP)
    assert abs(found.yaw - HIGH.yaw) < 3 * found.sigma
    assert found.source is not YawSource.BOTTOM
    assert found.sigma < np.radians(1.0)


@pytest.mark.parametrize("factor", [0.95, 0.98, 1.03])
def test_moving_along_the_viewing_ray_leaves_the_yaw(factor: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    here, there = measured(shot, t11), measured(shot, t11, slid(shot, POSE, factor))
    assert there.yaw == pytest.approx(here.yaw, abs=np.radians(0.12))


@pytest.mark.parametrize("turn_deg", [-1.5, -0.5, 1.0, 1.5])
def test_any_start_near_the_truth_gives_the_same_yaw(turn_deg: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    found = measured(shot, t11, turned(POSE, turn_deg))
    assert found.yaw == pytest.approx(measured(shot, t11).yaw, abs=np.radians(0.05))


def test_the_estimate_is_the_mean_of_the_votes_that_agree(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    found = measure_yaw(shot, viewed(shot, epal, POSE, YawSource.BOTTOM), POSE, epal, CONFIG)
    assert isinstance(found, YawEstimate)
    used = [vote for vote in found.votes if vote.used]
    assert len(used) >= 2
    weights = np.array([vote.sigma**-2 for vote in used])
    mean = float((weights * [vote.turn for vote in used]).sum() / weights.sum())
    assert found.yaw == pytest.approx(POSE.yaw + mean, abs=1e-9)
    assert found.sigma >= weights.sum() ** -0.5 - 1e-12
    assert all(vote.edge.horizontal for vote in found.votes)


def test_an_edge_that_is_partly_hidden_does_not_turn_the_yaw(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, POSE, YawSource.BOTTOM)
    image = seen.view.image.copy()
    grid = seen.view.grid
    left, right = (round((edge - grid.left) / grid.resolution) for edge in (0.35, 0.55))
    middle = round(grid.top / grid.resolution)
    image[middle + 3 :, left:right] = image[5, 5]  # something of the floor's colour stands before the lower edge
    hidden = replace(seen, view=replace(seen.view, image=image))
    found = measure_yaw(shot, hidden, POSE, t11, CONFIG)
    assert isinstance(found, YawEstimate)
    assert abs(found.yaw - POSE.yaw) < max(3 * found.sigma, np.radians(0.3))


def test_there_is_no_yaw_in_a_plain_image(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    plain = replace(shot, image=np.full_like(shot.image, 90))
    seen = viewed(plain, t11, POSE, YawSource.BOTTOM)
    assert measure_yaw(plain, seen, POSE, t11, CONFIG) is Reason.NO_LINE
    assert find_lines(seen, CONFIG) == []
    line = BoundaryLine(0.01, 0.0, 200)
    assert measure_line(plain, seen, line, t11, CONFIG) is None


@pytest.mark.parametrize("turn_deg", [-6.0, -2.0, 2.0, 6.0])
@pytest.mark.parametrize("boundary", BoundaryMethod)
def test_a_boundary_line_shows_how_far_the_start_is_turned(
    turn_deg: float, boundary: BoundaryMethod, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, turned(POSE, turn_deg), YawSource.BOTTOM)
    lines = find_lines(seen, replace(CONFIG, boundary=boundary))
    assert min(abs(line.turn + np.radians(turn_deg)) for line in lines) < np.radians(0.7)


@pytest.mark.parametrize("turn_deg", [-5.0, 3.0])
def test_a_line_is_measured_finer_than_it_was_found(turn_deg: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    seen = viewed(shot, t11, turned(POSE, turn_deg), YawSource.BOTTOM)
    truth = -np.radians(turn_deg)
    line = min(find_lines(seen, CONFIG), key=lambda one: (round(abs(one.up), 2), -one.votes))
    fit = measure_line(shot, seen, line, t11, CONFIG)
    assert fit is not None
    assert abs(np.arctan(fit.slope) - truth) < np.radians(0.3)


def test_the_same_view_gives_the_same_result(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    assert measured(shot, epal) == measured(shot, epal)
