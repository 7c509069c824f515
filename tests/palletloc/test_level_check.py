from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from palletloc.attempts import keep_best
from palletloc.level_check import LevelCheck, check_level, range_doubt
from palletloc.refinement.alignment import fit_face

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.patch import FacePatch, view_patch

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
CONFIG = LocalizerConfig()
Portrait = Callable[..., ShotView]


def slid(shot: ShotView, pose: LevelPose, height: float) -> LevelPose:
    """Return a pose on another height that appears at the same place in the image."""
    center = shot.mounting.center
    factor = (height - center[2]) / (pose.z - center[2])
    x, y = center[:2] + factor * (np.array([pose.x, pose.y]) - center[:2])
    return LevelPose(float(x), float(y), height, pose.yaw)


def on_level(shot: ShotView, model: PalletModel, level: float) -> Candidate:
    """Return a candidate fitted on a level."""
    candidate = Candidate(model, POSE, HeightPrior(level, 0.003))
    start, spread = slid(shot, POSE, level), float(np.radians(5.0))
    assert candidate.height is not None
    camera = shot.projector.camera
    face = fit_face(camera, shot.image, shot.mounting, start, model, candidate.height, None, spread, CONFIG.face_fit)
    assert not isinstance(face, Reason)
    candidate.face, candidate.pose, candidate.covariance = face, face.forklift_from_pallet, face.covariance
    return candidate


def checked(shot: ShotView, model: PalletModel, level: float) -> LevelCheck:
    found = check_level(shot, on_level(shot, model, level), CONFIG)
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_a_right_level_is_not_contradicted(name: str, portrait: Portrait, request: pytest.FixtureRequest) -> None:
    model: PalletModel = request.getfixturevalue(name)
    check = checked(portrait(model, POSE), model, POSE.z)
    assert not check.contradicts
    assert check.off < 3.0
    assert check.wrong < 0.05


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
@pytest.mark.parametrize("off", [-0.06, -0.05, 0.05, 0.06])
def test_a_level_wrong_by_some_centimetres_is_contradicted(
    name: str, off: float, portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    check = checked(portrait(model, POSE), model, POSE.z + off)
    assert check.contradicts
    assert check.apart[2] * -np.sign(off) > 0.01  # towards where it stands


def test_nothing_is_said_without_a_level_or_a_pose(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    assert check_level(shot, Candidate(t11, POSE, HeightPrior(0.0, 0.003)), CONFIG) is None
    free = on_level(shot, t11, 0.0)
    free.height = None
    assert check_level(shot, free, CONFIG) is None


@pytest.mark.parametrize(
    ("off", "wrong", "contradicts"), [(9.0, 0.99, True), (9.0, 0.4, False), (0.1, 0.99, False), (0.0, 0.0, False)]
)
def test_only_what_the_height_tells_contradicts_the_level(off: float, wrong: float, contradicts: bool) -> None:
    assert LevelCheck(np.zeros(4), off, wrong).contradicts is contradicts


@pytest.mark.parametrize("off", [-0.06, 0.06])
def test_a_contradicted_level_is_the_reason(off: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    start = slid(shot, POSE, off)
    patch = view_patch(shot.projector, shot.image, shot.camera_from_forklift, start, (-0.75, 0.75, -0.1, 0.3), 0.005)
    assert isinstance(patch, FacePatch)
    candidate = Candidate(epal, start, HeightPrior(off, 0.003))
    keep_best(shot, candidate, [(start, patch)], lambda _, pose: pose, False, CONFIG)
    assert candidate.refusal is not None
    assert candidate.refusal[1] in (Reason.OFF_LEVEL, Reason.FEW_EDGES)


def without_uprights(candidate: Candidate, missing: int) -> Candidate:
    """Return a candidate whose fit took so many uprights for those of something else."""
    face = candidate.face
    assert face is not None
    uprights = [i for i, one in enumerate(face.seen.edges) if not one.edge.horizontal]
    weights = np.ones(len(face.seen.edges))
    weights[uprights[:missing]] = 0.0
    return replace(candidate, face=replace(face, weights=weights))


def test_missing_uprights_leave_the_range_in_doubt(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    whole = on_level(shot, t11, POSE.z)
    added = [range_doubt(shot, without_uprights(whole, missing), CONFIG) for missing in range(5)]
    sizes = [float(np.sqrt(np.trace(one))) for one in added]
    assert sizes[0] < 0.5 * sizes[-1]
    assert (np.diff(sizes[1:]) > 0.03).all()
    _, axes = np.linalg.eigh(added[-1][:3, :3])
    assert whole.pose is not None
    ray = np.array([whole.pose.x, whole.pose.y, whole.pose.z]) - shot.mounting.center
    assert abs(axes[:, -1] @ ray) > 0.97 * np.linalg.norm(ray)
    assert (added[-1][3] == 0.0).all()


def test_level_lines_say_nothing_of_the_range(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    whole = without_uprights(on_level(shot, t11, POSE.z), 0)
    assert whole.face is not None
    level = np.array([one.edge.horizontal for one in whole.face.seen.edges])
    faint = replace(whole, face=replace(whole.face, weights=np.where(level, 0.0, 1.0)))
    np.testing.assert_array_equal(range_doubt(shot, faint, CONFIG), range_doubt(shot, whole, CONFIG))


def test_a_hidden_upright_confirms_no_range(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    missing = without_uprights(on_level(shot, t11, POSE.z), 3)
    assert missing.face is not None
    lost = [one.edge for one in missing.face.seen.edges if not one.edge.horizontal][:3]
    edges = tuple(one for one in missing.face.seen.edges if one.edge not in lost)
    spans = tuple((edge.middle[0] - 0.01, edge.middle[0] + 0.01) for edge in lost)
    seen = replace(missing.face.seen, edges=edges, hidden=spans)
    kept = np.array([one.edge not in lost for one in missing.face.seen.edges])
    hidden = replace(missing, face=replace(missing.face, seen=seen, weights=missing.face.weights[kept]))
    assert hidden.face is not None
    assert {edge.middle for edge in lost} <= {edge.middle for edge in hidden.face.hidden}
    np.testing.assert_allclose(range_doubt(shot, hidden, CONFIG), range_doubt(shot, missing, CONFIG))
