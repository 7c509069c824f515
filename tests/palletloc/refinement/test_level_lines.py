from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from palletloc.candidate import Candidate
from palletloc.config import LocalizerConfig
from palletloc.edge_fit import EdgeFit
from palletloc.face import EdgeKind, FaceEdge, FaceLine, edge_shift, face_lines
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior
from palletloc.methods import measure_refined
from palletloc.pallet import PalletModel
from palletloc.refinement.edges import MeasuredEdge, SeenFace
from palletloc.refinement.level_lines import LevelYaw, yaw_from_level_lines
from palletloc.shot import Shot

CONFIG = LocalizerConfig()
FLOOR = HeightPrior(0.0, 0.003)
POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
ABOVE, BELOW = (-0.6, 1.8, 2.1), (0.4, -1.1, 2.1)
"""Where the camera is in the face's coordinates: right, up, towards the viewer."""
ERROR_PX = 0.15
LEVEL = (EdgeKind.BOTTOM, EdgeKind.TOP, EdgeKind.OPENING_TOP, EdgeKind.OPENING_BOTTOM)
Camera = tuple[float, float, float]


def seen_point(point: Sequence[float], camera: FloatArray, yaw: float) -> FloatArray:
    """Where a point of the face, turned about its middle, appears on the face's plane: by a ray."""
    right, up = point
    ray = np.array([right * np.cos(yaw), up, -right * np.sin(yaw)]) - camera
    reached: FloatArray = (camera - ray * camera[2] / ray[2])[:2]
    return reached


def measured(
    line: FaceLine, model: PalletModel, camera: Camera, yaw: float, off: float, sigma: float
) -> MeasuredEdge:
    """What is measured of a line of a turned face, with a slope that is wrong by some."""
    edge: FaceEdge = line.whole
    center = np.array(camera)
    ends = [seen_point(point, center, yaw) - point for point in (edge.start, edge.end)]
    slope = float((ends[1] - ends[0]) @ edge.outward) / edge.length + off
    offset = float((seen_point(edge.middle, center, yaw) - edge.middle) @ edge.outward)
    fit = EdgeFit(offset, slope, 1e-4, sigma, 1.0, 10.0)
    return MeasuredEdge(edge, fit, 1e-3, edge_shift(edge, center, model), 0.003, 1.0)


def turned(
    model: PalletModel,
    camera: Camera,
    yaw: float,
    kinds: Sequence[EdgeKind] = tuple(EdgeKind),
    off: dict[EdgeKind, float] | None = None,
    sigma: float = 1e-3,
) -> SeenFace:
    lines = [line for line in face_lines(model) if line.kind in kinds]
    wrong = off or {}
    edges = tuple(measured(line, model, camera, yaw, wrong.get(line.kind, 0.0), sigma) for line in lines)
    return SeenFace(np.array(camera), np.eye(4), tuple(line.whole for line in lines), edges, len(edges))


def said(seen: SeenFace, error_px: float = ERROR_PX) -> LevelYaw:
    found = yaw_from_level_lines(seen, error_px)
    assert found is not None
    return found


@pytest.mark.parametrize("yaw", [-0.02, -0.004, 0.0, 0.004, 0.02])
@pytest.mark.parametrize("camera", [ABOVE, BELOW, (0.0, 0.6, 3.5)])
def test_the_level_lines_tell_how_far_a_face_is_turned(camera: Camera, yaw: float, epal: PalletModel) -> None:
    found = said(turned(epal, camera, yaw))
    assert found.turn == pytest.approx(yaw, abs=0.03 * abs(yaw) + 1e-6)
    assert abs(found.turn - yaw) < found.sigma


@pytest.mark.parametrize("kind", LEVEL)
def test_each_level_line_tells_it_alone(kind: EdgeKind, epal: PalletModel) -> None:
    found = said(turned(epal, BELOW, 0.01, [kind]))
    assert found.turn == pytest.approx(0.01, abs=5e-4)
    assert found.lines == 1


def test_more_lines_that_agree_are_surer_than_one(epal: PalletModel) -> None:
    few, many = (said(turned(epal, BELOW, 0.01, kinds)) for kinds in (LEVEL[:1], LEVEL))
    assert (few.lines, many.lines) == (1, 4)
    assert many.sigma < 0.7 * few.sigma


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["above", "below"])
def test_the_nearer_to_the_cameras_height_the_less_certain(side: float, epal: PalletModel) -> None:
    sigmas = [said(turned(epal, (0.2, 0.07 + side * up, 2.0), 0.01)).sigma for up in (1.6, 0.8, 0.4, 0.2)]
    assert (np.diff(sigmas) > 0).all()
    assert sigmas[-1] > 4 * sigmas[0]


def test_the_worse_the_slopes_are_known_the_less_certain(epal: PalletModel) -> None:
    slopes = [said(turned(epal, ABOVE, 0.01, sigma=sigma)).sigma for sigma in (1e-3, 3e-3, 1e-2)]
    pixels = [said(turned(epal, ABOVE, 0.01), error).sigma for error in (0.1, 1.0, 3.0)]
    assert (np.diff(slopes) > 0).all()
    assert (np.diff(pixels) > 0).all()


def test_lines_level_with_the_camera_tell_nothing(epal: PalletModel) -> None:
    up = epal.openings[0].top
    assert yaw_from_level_lines(turned(epal, (0.3, up, 2.0), 0.01, [EdgeKind.OPENING_TOP]), ERROR_PX) is None
    assert said(turned(epal, (0.3, up, 2.0), 0.01, LEVEL)).lines < len(LEVEL)


def test_without_level_lines_there_is_no_yaw(epal: PalletModel) -> None:
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, [EdgeKind.SIDE, EdgeKind.OPENING_SIDE]), ERROR_PX) is None
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, []), ERROR_PX) is None


@pytest.mark.parametrize("kind", LEVEL)
@pytest.mark.parametrize("off", [0.05, -0.05])
def test_one_line_of_four_that_contradicts_is_outvoted(kind: EdgeKind, off: float, epal: PalletModel) -> None:
    calm, disturbed = (said(turned(epal, BELOW, 0.01, LEVEL, off=one)) for one in ({}, {kind: off}))
    assert disturbed.turn == pytest.approx(calm.turn, abs=3e-4)
    assert disturbed.lines == calm.lines - 1 == 3
    assert disturbed.sigma >= calm.sigma


def test_lines_that_differ_make_the_yaw_less_certain(epal: PalletModel) -> None:
    spread = {EdgeKind.BOTTOM: 2e-3, EdgeKind.TOP: 2e-3}
    calm, restless = (said(turned(epal, BELOW, 0.01, LEVEL, off=one)) for one in ({}, spread))
    assert restless.lines == calm.lines
    assert restless.sigma > 1.2 * calm.sigma


def test_the_upper_edge_has_no_say_where_a_load_may_begin_there(epal: PalletModel) -> None:
    calm, loaded = (said(turned(epal, ABOVE, 0.01, off=one)) for one in ({}, {EdgeKind.TOP: 0.003}))
    assert loaded == calm
    assert yaw_from_level_lines(turned(epal, ABOVE, 0.01, [EdgeKind.TOP]), ERROR_PX) is None
    assert yaw_from_level_lines(turned(epal, BELOW, 0.01, [EdgeKind.TOP]), ERROR_PX) is not None


@pytest.mark.parametrize("turn", [0.0, -0.1])
def test_on_a_pallet_on_the_floor_the_lines_agree_with_the_truth(
    model: PalletModel, turn: float, portrait: Callable[..., Shot]
) -> None:
    pose = replace(POSE, yaw=POSE.yaw + turn)
    fit = measure_refined(portrait(model, pose), Candidate(model, pose, FLOOR), CONFIG).fit
    assert fit is not None
    assert fit.face is not None
    found = fit.face.level_yaw
    assert found is not None
    assert abs(fit.pose.yaw + found.turn - pose.yaw) < 3 * found.sigma
    assert found.sigma < np.radians(0.6)
