import numpy as np
import pytest

from palletloc.evaluation.errors import PoseError, ShotErrors, TrueFace
from palletloc.evaluation.summary import summarize
from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement, YawSource

POSE = LevelPose(1.0, 2.0, 0.0, 1.5)
FACE = TrueFace("A", "t11", POSE, 2.0, 1.8, True)
FALSE = PalletMeasurement(0.0, "t11", POSE, np.eye(4), 0.5, YawSource.BOTTOM)


def error(yaw: float, depth: float = 0.0, nees: float = 1.0, same_model: bool = True) -> PoseError:
    return PoseError(FACE, depth, 0.0, 0.0, yaw, nees, same_model)


def shot(errors: tuple[PoseError, ...] = (), missed: int = 0, false: int = 0) -> ShotErrors:
    return ShotErrors(0.0, errors, (FACE,) * missed, (FALSE,) * false, 1.8)


def test_counts_are_over_all_shots() -> None:
    summary = summarize([shot((error(0.1), error(0.2)), missed=1, false=2), shot((error(0.1),)), shot()])
    assert (summary.shots, summary.visible, summary.found, summary.false) == (3, 4, 3, 2)
    assert summary.recall == 3 / 4
    assert summary.false_per_shot == pytest.approx(2 / 3)


def test_spreads_are_of_sizes_and_the_bias_of_signed_values() -> None:
    values = [-0.3, 0.1, 0.2, 0.4, -0.5]
    yaw = summarize([shot(tuple(error(value) for value in values))]).yaw
    assert yaw is not None
    assert (yaw.median, yaw.maximum, yaw.bias) == (0.3, 0.5, 0.1)
    # between the fourth and the fifth of five: at 0.95 * 4 = 3.8 steps
    assert yaw.p95 == pytest.approx(0.4 + 0.8 * 0.1)


def test_errors_of_one_kind_do_not_mix_with_another() -> None:
    summary = summarize([shot((error(0.1, depth=-0.02),))])
    assert summary.depth is not None
    assert summary.yaw is not None
    assert (summary.depth.median, summary.depth.bias, summary.yaw.median) == (0.02, -0.02, 0.1)


def test_nees_and_models_are_means() -> None:
    summary = summarize([shot((error(0, nees=1.0), error(0, nees=6.0, same_model=False)))])
    assert (summary.nees, summary.same_model) == (3.5, 0.5)


def test_a_single_covariance_that_is_none_shows() -> None:
    assert summarize([shot((error(0, nees=1.0), error(0, nees=np.inf)))]).nees == np.inf


def test_nothing_gives_no_numbers() -> None:
    empty = summarize([])
    assert (empty.visible, empty.yaw, empty.depth) == (0, None, None)
    assert np.isnan([empty.recall, empty.false_per_shot, empty.nees, empty.same_model]).all()
    found_nothing = summarize([shot(missed=2)])
    assert (found_nothing.recall, found_nothing.yaw) == (0.0, None)
