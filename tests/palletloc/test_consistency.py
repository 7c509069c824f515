"""Do covariances tell the truth? Errors over many pictures, with pallets and mountings that are a little off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.pallet import PalletModel
from palletloc.shot import Shot
from palletloc.synthetic.aisle import misshapen
from palletloc.synthetic.rig import disturbed

COUNT = 45
FLOOR, LEVEL, ABOVE = 0.0, 1.7, 2.9
Portrait = Callable[..., Shot]


def squared_errors(
    z: float, known: bool, portrait: Portrait, models: tuple[PalletModel, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the normalised estimation error squared of each measurement, and the errors themselves."""
    rng = np.random.default_rng(1)
    squared, errors = [], []
    for number in range(COUNT):
        model = models[number % len(models)]
        x, y = rng.uniform([-0.6, 1.7], [2.2, 2.4])
        pose = LevelPose(float(x), float(y), z, np.pi / 2 + 0.03 * float(rng.standard_normal()))
        shot = portrait(misshapen(model, 1.0, rng), pose, seed=number)
        recorded = disturbed(shot.mounting.forklift_from_camera, 0.001, 0.0003, rng)
        mounting = replace(shot.mounting, forklift_from_camera=recorded)
        start = LevelPose(*(pose.as_array() + rng.normal(0.0, [0.02, 0.02, 0.0, 0.02])).tolist())
        levels = (z,) if known else ()
        assumed = replace(shot, mounting=mounting)
        found = Localizer([model]).localize_from(assumed, [Start(model.name, start)], levels)[0]
        if found is not None:
            error = found.forklift_from_pallet.minus(pose)
            squared.append(float(error @ np.linalg.solve(found.covariance, error)))
            errors.append(error)
    return np.array(squared), np.array(errors)


@pytest.mark.slow
def test_on_the_floor_errors_are_as_large_as_the_covariances_say(
    portrait: Portrait, epal: PalletModel, t11: PalletModel, open_below: PalletModel
) -> None:
    squared, errors = squared_errors(FLOOR, True, portrait, (epal, t11, open_below))
    assert len(squared) >= 40
    assert 0.7 < squared.mean() < 10.0
    assert 0.7 < np.median(squared) < 8.0
    assert np.percentile(np.abs(errors[:, :3]), 95) < 0.02
    assert np.percentile(np.abs(errors[:, 3]), 95) < np.radians(0.6)


@pytest.mark.slow
@pytest.mark.parametrize(("z", "measured"), [(LEVEL, 0.4), (ABOVE, 0.9)], ids=["level", "above"])
def test_near_and_above_the_camera_most_errors_are_as_large_as_the_covariances_say(
    z: float, measured: float, portrait: Portrait, epal: PalletModel, t11: PalletModel, open_below: PalletModel
) -> None:
    squared, _ = squared_errors(z, True, portrait, (epal, t11, open_below))
    assert len(squared) >= measured * COUNT  # level with the camera, many poses are too uncertain to be reported
    assert 0.7 < np.median(squared) < 10.0
    assert np.mean(squared > 40.0) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("z", [FLOOR, ABOVE], ids=["floor", "above"])
def test_without_a_known_height_most_errors_are_as_large_as_the_covariances_say(
    z: float, portrait: Portrait, epal: PalletModel, t11: PalletModel, open_below: PalletModel
) -> None:
    squared, _ = squared_errors(z, False, portrait, (epal, t11, open_below))
    assert len(squared) >= 0.9 * COUNT
    assert 0.7 < np.median(squared) < 10.0
    assert np.mean(squared > 40.0) < 0.2  # along the ray every edge still fits: some settle in a wrong place
