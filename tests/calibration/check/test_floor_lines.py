import numpy as np
import pytest

from calibration.check.floor_lines import FloorSegments, floor_segments, floor_tilt
from calibration.shelf.line_segments import Segments
from palletloc.geometry import FloatArray
from palletloc.shelf import ShelfPlane

CENTER = np.array([0.3, 0.1, 1.8])
FRONT = ShelfPlane(0.0, 2.2, -np.pi / 2)


def turned(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    return vectors + np.cross(np.array([*turn, 0.0]), vectors)


def floor(rng: np.random.Generator, turn: FloatArray, lines: list[tuple[float, float]]) -> FloorSegments:
    """Return lines of a floor, each a heading and the distance from odom's origin, seen along a way of two metres."""
    shots, poses = [], []
    for way in np.linspace(0.0, 2.0, 5):
        normals, middles = [], []
        for heading, place in lines:
            along = np.array([np.cos(heading), np.sin(heading), 0.0])
            foot = place * np.array([-along[1], along[0], 0.0]) - CENTER - [way, 0.0, 0.0]
            for reach in (-0.5, 0.8):
                point = foot + (reach - foot @ along) * along
                normal = np.cross(point, along)
                normal /= np.linalg.norm(normal)
                normals.append(turned(normal, turn) + 0.0005 * rng.standard_normal() * along)
                middles.append(turned(point / np.linalg.norm(point), turn))
        count = len(normals)
        shots.append(Segments(np.array(normals), np.array(middles), np.full(count, 0.2), np.full(count, 0.0005)))
        poses.append([way, 0.0, 0.0])
    return floor_segments(shots, np.array(poses), CENTER, FRONT)


def test_lines_on_the_floor_tell_the_turn_within_what_they_state() -> None:
    square = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        turn = np.radians(rng.uniform(-0.4, 0.4, 2))
        lines = [(0.0, -1.3), (0.0, 1.6), (np.pi / 2, 0.9), (np.pi / 2, -2.1)]
        built = [(heading + np.radians(0.2) * rng.standard_normal(), place) for heading, place in lines]
        tilt = floor_tilt(floor(rng, turn, built))
        assert tilt is not None
        off = tilt.turn - turn
        square.append(float(off @ tilt.information @ off))
    assert np.mean(square) < 3.5  # two degrees of freedom, lines truer than assumed
    assert np.max(square) < 14


def test_lines_along_the_way_leave_the_turn_about_it_open() -> None:
    tilt = floor_tilt(floor(np.random.default_rng(1), np.radians([0.3, 0.3]), [(0.0, -1.4), (0.0, 1.5)]))
    assert tilt is not None
    values, axes = np.linalg.eigh(tilt.information)
    assert values[0] == pytest.approx(0.0, abs=1e-6 * values[1])
    assert abs(axes[1, 1]) == pytest.approx(1.0, abs=0.02)
    assert abs(tilt.turn[1] - np.radians(0.3)) < 3 / np.sqrt(values[1])


def test_marks_of_tyres_are_not_lines_that_count() -> None:
    assert floor_tilt(floor(np.random.default_rng(1), np.zeros(2), [(np.radians(6.0), 0.5)])) is None


def test_what_seems_to_lie_behind_the_front_is_no_floor() -> None:
    assert floor_tilt(floor(np.random.default_rng(1), np.zeros(2), [(0.0, 2.4), (0.0, 3.0)])) is None
