"""Odometry held against itself. The drives integrate their rates exactly; noise and slip are added to them."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.io.odometry_check import OdometryColumns, OdometryError, check_odometry, check_times
from palletloc.io.recording import read_recording

FILE = Path("odometry.csv")


def drive(bend: float = 0.15, duration: float = 8.0, speed: float = 0.6, rate: float = 50.0) -> OdometryColumns:
    """Return a drive that starts from rest and swings, up to some rate in rad/s."""
    time = np.arange(0.0, duration, 1 / rate)
    v = speed * np.clip(time, 0.0, 1.0)
    w = bend * np.sin(0.9 * time)
    yaw = np.concatenate([[0.0], np.cumsum((w[1:] + w[:-1]) / 2 / rate)])
    step = (v[1:] + v[:-1]) / 2 / rate * np.exp(0.5j * (yaw[1:] + yaw[:-1]))
    place = np.concatenate([[0.0], np.cumsum(step)])
    return OdometryColumns(time, place.real, place.imag, yaw, v, w)


def changed(columns: OdometryColumns, **how: Any) -> OdometryColumns:
    """Return odometry with some columns multiplied."""
    return replace(columns, **{name: factor * getattr(columns, name) for name, factor in how.items()})


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"yaw": 180 / np.pi}, "yaw_rad turns 57.3 times as far as yaw_rate_radps says: degrees?"),
        ({"yaw": -180 / np.pi}, "yaw_rad turns -57.3 times as far as yaw_rate_radps says: degrees, clockwise?"),
        ({"yaw": -1}, "yaw_rad turns -1 times as far as yaw_rate_radps says: clockwise?"),
        ({"x": 1000, "y": 1000}, "x_m, y_m go 1000 times as far as speed_mps says: millimetres?"),
        ({"x": 100, "y": 100}, "x_m, y_m go 100 times as far as speed_mps says: centimetres?"),
        ({"x": 3.2808, "y": 3.2808}, "x_m, y_m go 3.28 times as far as speed_mps says: feet?"),
        ({"time": 1e3}, "x_m, y_m go 0.001 times as far as speed_mps says: time_s in milliseconds?"),
        ({"time": 1e9}, "x_m, y_m go 1e-09 times as far as speed_mps says: time_s in nanoseconds?"),
        (
            {"y": -1},
            "the way of x_m, y_m turns -1 times as far as yaw_rad says: y_m to the right, or yaw_rad clockwise?",
        ),
        (
            {"yaw": -1, "yaw_rate": -1},
            "turns -1 times as far as yaw_rad says: y_m to the right, or yaw_rad clockwise?",
        ),
        ({"yaw": 57.2958, "yaw_rate": 57.2958}, "turns 0.0175 times as far as yaw_rad says: yaw_rad in degrees?"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
@pytest.mark.parametrize("bend", [0.05, 0.4])
def test_odometry_that_cannot_be_used_is_refused_with_the_factor(
    how: dict[str, float], said: str, bend: float
) -> None:
    with pytest.raises(OdometryError) as error:
        check_odometry(FILE, changed(drive(bend), **how))
    told, expected = (re.split(r" (?=[-\d.e]+ times)| (?=times)", line) for line in (str(error.value), said))
    assert told[0].startswith("odometry.csv: ")
    assert told[0].endswith(expected[0])
    assert float(told[1]) == pytest.approx(float(expected[1]), rel=0.02)
    assert told[2] == expected[2]


def test_exchanged_axes_are_refused() -> None:
    given = drive()
    with pytest.raises(OdometryError, match=r"x_m, y_m go \d+ degrees to the left of yaw_rad: axes exchanged\?"):
        check_odometry(FILE, replace(given, x=-given.y, y=given.x))


def test_degrees_are_told_across_their_whole_turn_and_from_few_samples() -> None:
    for given in (drive(0.4), drive(0.4, rate=5.0)):
        wrapped = (np.degrees(given.yaw + 3.1) + 180) % 360 - 180
        with pytest.raises(OdometryError, match=r"turns 57\.\d times as far as yaw_rate_radps says: degrees"):
            check_odometry(FILE, replace(given, yaw=wrapped))


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"yaw_rate": 180 / np.pi}, "yaw_rad turns 0.0175 times as far as yaw_rate_radps says: degrees/s?"),
        ({"speed": 3.6}, "x_m, y_m go 0.278 times as far as speed_mps says: km/h?"),
        ({"speed": -1}, "x_m, y_m go 180 degrees to the"),
    ],
    ids=["yaw rate", "speed", "sign of the speed"],
)
def test_rates_in_other_units_are_told_and_the_poses_used(how: dict[str, float], said: str) -> None:
    (note,) = check_odometry(FILE, changed(drive(), **how))
    assert said in note


def test_a_reset_is_told_with_its_time() -> None:
    given = drive()
    after = np.arange(len(given.time)) >= 250
    x, y = (column - after * column[250] for column in (given.x, given.y))
    (note,) = check_odometry(FILE, replace(given, x=x, y=y, yaw=given.yaw - after * given.yaw[250]))
    driven = np.hypot(given.x[249], given.y[249])
    assert note.startswith(f"odometry.csv: at 5 s the pose jumps by {driven:.2f} m and ")
    assert note.endswith(" within 0.02 s: a reset?")


def sound() -> dict[str, OdometryColumns]:
    """Return odometry of which none contradicts itself, whatever else is wrong with it."""
    rng, given = np.random.default_rng(4), drive()
    n = len(given.time)
    still = changed(given, x=0, y=0, yaw=0, speed=0, yaw_rate=0)
    noise = {name: rng.normal(size=n) for name in ("x", "y", "yaw", "speed", "yaw_rate")}

    def noisy(columns: OdometryColumns, size: float) -> OdometryColumns:
        return replace(columns, **{name: getattr(columns, name) + size * noise[name] for name in noise})

    backwards = changed(given, x=-1, y=-1, speed=-1)
    slips = np.where(given.time % 2.5 < 0.8, 2.5, 1.0)
    turn = np.exp(2.2j) * (given.x + 1j * given.y)
    lever = 0.5 * (np.exp(1j * given.yaw) - 1)
    return {
        "exact": given,
        "straight": drive(0.0),
        "slow": drive(0.02, speed=0.05),
        "noisy": noisy(given, 0.005),
        "standing": still,
        "standing, noisy": noisy(still, 0.01),
        "wheels that slip": replace(given, speed=given.speed * slips),
        "wheels that are worn": changed(given, speed=1.03),
        "a gyroscope's bias": replace(given, yaw_rate=0.01 + np.asarray(given.yaw_rate)),
        "backwards": backwards,
        "another frame": replace(given, x=turn.real + 40, y=turn.imag - 7, yaw=given.yaw + 2.2),
        "a point off the axle": replace(given, x=given.x + lever.real, y=given.y + lever.imag),
        "without rates": replace(given, speed=None, yaw_rate=None),
        "seconds since 1970": replace(given, time=given.time + 1.7e9),
        "one sample": OdometryColumns(*(np.zeros(1) for _ in range(6))),
    }


@pytest.mark.parametrize("name", sound())
def test_sound_odometry_has_nothing_to_tell(name: str) -> None:
    assert check_odometry(FILE, sound()[name]) == ()


@pytest.mark.parametrize(
    ("time", "said"),
    [
        (1.7e18, "odometry.csv: time_s: 1.7e18: nanoseconds?"),
        (1.79e15, "odometry.csv: time_s: 1.7e15: microseconds?"),
        (1.7e12, "odometry.csv: time_s: 1.7e12: milliseconds?"),
    ],
)
def test_stamps_in_other_units_are_named(time: float, said: str) -> None:
    with pytest.raises(OdometryError) as error:
        check_times(FILE, np.array([time, time + 1]))
    assert str(error.value) == said


@pytest.fixture(scope="module")
def sample() -> OdometryColumns:
    odometry = read_recording(Path(__file__).resolve().parents[3] / "palletloc/sample").odometry
    return OdometryColumns(odometry.times, odometry.x, odometry.y, odometry.yaw, odometry.speed, odometry.yaw_rate)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({}, None),
        ({"yaw": 180 / np.pi}, "degrees?"),
        ({"x": 1000, "y": 1000}, "millimetres?"),
        ({"y": -1}, "y_m to the right"),
        ({"yaw": -1}, "clockwise"),
        ({"yaw": -1, "yaw_rate": -1}, "yaw_rad clockwise"),
        ({"time": 1e9}, "nanoseconds"),
    ],
    ids=["as it is", "degrees", "millimetres", "y to the right", "clockwise", "clockwise rates", "nanoseconds"],
)
def test_a_real_approach_which_hardly_turns_tells_the_same(
    sample: OdometryColumns, how: dict[str, float], said: str | None
) -> None:
    if said is None:
        assert check_odometry(FILE, sample) == ()
    else:
        with pytest.raises(OdometryError, match=said):
            check_odometry(FILE, changed(sample, **how))
