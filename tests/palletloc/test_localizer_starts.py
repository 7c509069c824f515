"""The same measurements from given starts instead of detections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose, level_pose
from palletloc.localizer import Localizer, Start
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.shot import Shot

COARSE = replace(LocalizerConfig(), joint_search=JointSearchConfig(turns=9, depths=9))
Placed = tuple[PalletModel, LevelPose]
Makes = Callable[..., Localizer]


@pytest.mark.parametrize("method", Method)
def test_all_methods_give_results_of_one_form(
    method: Method, floor_localizer: Makes, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    starts = [Start(model.name, pose) for model, pose in floor_pallets]
    explained = floor_localizer(method, config=COARSE).explain_from(
        replace(floor_shot, time=3.0, file="c.jpg"), starts, (0.0,)
    )
    assert [outcome.candidate.model.name for outcome in explained.outcomes] == [start.model for start in starts]
    assert len(explained.measurements) + len(explained.refusals) == len(starts)
    assert explained.measurements
    for one in explained.measurements:
        assert (one.time, one.file) == (3.0, "c.jpg")
        assert one.covariance.shape == (4, 4)
        np.testing.assert_allclose(one.covariance, one.covariance.T, rtol=1e-9, atol=1e-15)
        assert np.linalg.eigvalsh(one.covariance).min() > 0
        assert 0.0 <= one.score <= 1.0
        assert isinstance(one.yaw_from, YawSource)
        truth = next(pose for model, pose in floor_pallets if model.name == one.model)
        assert np.abs(one.forklift_from_pallet.minus(truth)[:3]).max() < 0.1


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        ({"x": np.nan}, Reason.NOT_FINITE),
        ({"yaw": np.inf}, Reason.NOT_FINITE),
        ({"z": np.nan}, Reason.NOT_FINITE),
        ({"x": 0.3, "y": -2.0}, Reason.BEHIND_FACE),
        ({"yaw": -np.pi / 2}, Reason.BEHIND_FACE),
        ({"y": 60.0}, Reason.OUT_OF_RANGE),
        ({"x": -1e200}, Reason.OUT_OF_RANGE),
    ],
    ids=str,
)
def test_a_start_that_cannot_be_used_is_refused(
    method: Method,
    broken: dict[str, float],
    reason: Reason,
    floor_localizer: Makes,
    floor_shot: Shot,
    floor_pallets: tuple[Placed, ...],
) -> None:
    model, pose = floor_pallets[0]
    explained = floor_localizer(method, config=COARSE).explain_from(
        floor_shot, [Start(model.name, replace(pose, **broken))]
    )
    assert [one.reason for one in explained.refusals] == [reason]
    assert explained.measurements == []


@pytest.mark.parametrize("above", [0.1442, 0.1440001, 0.05])
def test_a_start_right_before_the_camera_is_refused(
    above: float, floor_localizer: Makes, floor_shot: Shot, t11: PalletModel
) -> None:
    x, y, z = floor_shot.mounting.center.tolist()
    start = Start(t11.name, LevelPose(x, y + 0.4, z - above, np.pi / 2))
    explained = floor_localizer().explain_from(floor_shot, [start])
    assert explained.measurements == []
    assert len(explained.refusals) == 1


def test_given_starts_are_answered_one_by_one_in_order(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    (wood, near), (plastic, far) = floor_pallets
    lost = LevelPose(np.nan, 2.0, 0.0, np.pi / 2)
    starts = [
        Start(plastic.name, far),
        Start("no-such-pallet", near),
        Start(wood.name, lost),
        Start(wood.name, near),
        Start(wood.name, near),
    ]
    found = floor_localizer().localize_from(floor_shot, starts, (0.0,))
    assert [None if one is None else one.model for one in found] == [plastic.name, None, None, wood.name, wood.name]
    first, second = found[3:]
    assert first is not None
    assert second is not None
    assert first.forklift_from_pallet == second.forklift_from_pallet
    np.testing.assert_array_equal(first.covariance, second.covariance)
    explained = floor_localizer().explain_from(floor_shot, starts, (0.0,))
    assert [(one.model, one.stage, one.reason) for one in explained.refusals] == [
        ("no-such-pallet", Stage.START, Reason.UNKNOWN_MODEL),
        (wood.name, Stage.START, Reason.NOT_FINITE),
    ]


def test_starts_apart_lead_to_the_same_pallet(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    for model, pose in floor_pallets:
        starts = [
            Start(model.name, LevelPose(pose.x + dx, pose.y + dy, pose.z, pose.yaw + turn))
            for dx, dy, turn in ((0.0, 0.0, 0.0), (0.04, 0.03, 0.03), (-0.03, -0.04, -0.05), (0.0, 0.06, 0.04))
        ]
        found = floor_localizer().localize_from(floor_shot, starts, (0.0,))
        assert None not in found
        poses = np.array([one.forklift_from_pallet.as_array() for one in found if one is not None])
        sigma = np.sqrt(np.max([np.diag(one.covariance) for one in found if one is not None], axis=0))
        assert (np.ptp(poses, axis=0) < 2 * sigma).all()


def test_another_place_of_the_forklift_frame_moves_everything_with_it(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    moved = LevelPose(0.7, -1.1, 0.0, 0.6)  # new frame from old
    mounting = replace(
        floor_shot.mounting, forklift_from_camera=moved.transform() * floor_shot.mounting.forklift_from_camera
    )
    starts = [Start(model.name, pose) for model, pose in floor_pallets]
    there = [Start(s.model, level_pose(moved.transform() * s.forklift_from_pallet.transform())) for s in starts]
    before = floor_localizer().localize_from(floor_shot, starts, (0.0,))
    after = floor_localizer().localize_from(replace(floor_shot, mounting=mounting), there, (0.0,))
    turn = np.eye(4)
    turn[:2, :2] = moved.matrix()[:2, :2]
    for one, other in zip(after, before, strict=True):
        assert one is not None
        assert other is not None
        expected = level_pose(moved.transform() * other.forklift_from_pallet.transform())
        assert np.abs(one.forklift_from_pallet.minus(expected)).max() < 1e-4
        np.testing.assert_allclose(one.covariance, turn @ other.covariance @ turn.T, rtol=0.02, atol=1e-8)


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("along_ray", [-0.25, 0.45])
def test_a_start_far_off_along_the_viewing_ray_leads_to_the_pallet(
    along_ray: float,
    index: int,
    floor_localizer: Makes,
    floor_shot: Shot,
    floor_pallets: tuple[Placed, ...],
) -> None:
    model, pose = floor_pallets[index]
    center = floor_shot.mounting.center
    ray = pose.as_array()[:3] - center
    x, y, _ = center + ray * (1 + along_ray / np.linalg.norm(ray))
    start = replace(pose, x=float(x), y=float(y), yaw=pose.yaw + np.radians(2.0))
    (found,) = floor_localizer().localize_from(floor_shot, [Start(model.name, start)], (0.0,))
    assert found is not None
    error = np.abs(found.forklift_from_pallet.as_array() - pose.as_array())
    assert error[:3].max() < 0.03
    assert error[3] < np.radians(1.0)


def test_one_localizer_takes_shots_of_any_camera_in_any_order(
    portrait: Callable[..., Shot], floor_shot: Shot, floor_pallets: tuple[Placed, ...], t11: PalletModel
) -> None:
    pose = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
    given = [(floor_shot, Start("t11", floor_pallets[1][1])), (portrait(t11, pose), Start("t11", pose))]
    localizer = Localizer([t11])
    for shot, start in (*given, *given[::-1]):
        (row,), (alone,) = (each.localize_from(shot, [start], (0.0,)) for each in (localizer, Localizer([t11])))
        assert row is not None
        assert alone is not None
        assert row.forklift_from_pallet == alone.forklift_from_pallet
        np.testing.assert_array_equal(row.covariance, alone.covariance)
