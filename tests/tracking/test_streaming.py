from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.errors import PalletLocError
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.images import ImageError
from palletloc.io.recording import read_recording
from palletloc.localizer import Localizer
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.events import Event, EventKind
from tracking.motion import Twist
from tracking.observation import ShotTaken
from tracking.odometry import Odometry
from tracking.streaming import MOST_HELD, CameraShot, RecordingSource, ShelfLocalizer, stream
from tracking.tracker import Input, PalletTracker

SAMPLE = Path(str(files("palletloc") / "sample"))
PALLET = LevelPose(3.0, 1.9, 0.0, 1.5)
DARK = np.zeros((2, 4), np.uint8)
Given = Input | CameraShot


def pose_at(time: float) -> LevelPose:
    return LevelPose(0.5 * time, 0.02 * time, 0.0, 0.1 * time)


def sample(time: float) -> Odometry:
    return Odometry(time, pose_at(time), Twist(0.5, 0.0, 0.1))


def shot(time: float) -> CameraShot:
    return CameraShot(time, DARK, f"{time}.jpg")


def drive(seconds: float = 3.0) -> list[Given]:
    """Return odometry at 20 Hz, and a shot between samples twice a second, in order of time."""
    times = np.arange(0, seconds, 0.05)
    given: list[Given] = [*map(sample, times.tolist()), *map(shot, np.arange(0.11, seconds, 0.5).tolist())]
    return sorted(given, key=lambda given: given.time)


def late(given: Iterable[Given], by: float) -> list[Given]:
    """Return the same in the order of arrival if shots take longer."""
    return sorted(given, key=lambda arrived: arrived.time + (by if isinstance(arrived, CameraShot) else 0.0))


@dataclass
class Eye:
    """Sees the pallet where it is, a little off in a way that depends on the shot only; fails where told to."""

    faults: dict[float, Exception] = field(default_factory=dict)
    asked: list[float] = field(default_factory=list)
    poses: list[LevelPose] = field(default_factory=list)

    def localize(self, shot: CameraShot, odom_from_forklift: LevelPose) -> Sequence[PalletMeasurement]:
        self.asked.append(shot.time)
        self.poses.append(odom_from_forklift)
        if shot.time in self.faults:
            raise self.faults[shot.time]
        return [seen(shot.time)]


def seen(time: float) -> PalletMeasurement:
    there = level_pose(pose_at(time).transform().inv() * PALLET.transform())
    off = 0.004 * np.sin(40 * time)
    moved = LevelPose(there.x + off, there.y - off, there.z, there.yaw + off)
    return PalletMeasurement(time, "t11", moved, np.diag([1e-4, 1e-4, 4e-5, 1e-4]), 0.9, YawSource.FACE)


def kinds(events: Iterable[Event]) -> list[EventKind]:
    return [event.kind for event in events]


def test_it_is_the_same_as_measuring_and_pushing_by_hand() -> None:
    streamed, by_hand = PalletTracker(), PalletTracker()
    events = list(stream(drive(), Eye(), streamed))
    expected: list[Event] = []
    for given in drive():
        expected += by_hand.push(
            [ShotTaken(given.time), seen(given.time)] if isinstance(given, CameraShot) else given
        )
    assert events == expected
    assert (streamed.state(1).covariance == by_hand.state(1).covariance).all()
    assert streamed.state(1).pose == by_hand.state(1).pose


@pytest.mark.parametrize("delay", [0.02, 0.4, 1.7])
def test_when_shots_arrive_inside_the_window_does_not_matter(delay: float) -> None:
    in_time, delayed = PalletTracker(), PalletTracker()
    for tracker, given in ((in_time, drive()), (delayed, late(drive(), delay))):
        assert EventKind.REJECTED not in kinds(stream(given, Eye(), tracker))
    states = [tracker.state(1, at=2.95) for tracker in (in_time, delayed)]
    assert states[1].pose.as_array() == pytest.approx(states[0].pose.as_array(), abs=1e-9)
    assert states[1].covariance == pytest.approx(states[0].covariance, abs=1e-9)
    assert states[1].hits == states[0].hits == 6


def test_events_come_while_the_source_still_gives() -> None:
    tracker, eye = PalletTracker(), Eye()
    for _ in stream(iter(drive()), eye, tracker):
        if tracker.tracks():
            break
    assert eye.asked == [0.11]


@pytest.mark.parametrize("fault", [ImageError("0.61.jpg: is empty"), OSError("disk gone"), PalletLocError("bad")])
def test_a_shot_that_cannot_be_used_is_told_and_the_stream_goes_on(fault: Exception) -> None:
    tracker = PalletTracker()
    events = list(stream(drive(), Eye({0.61: fault}), tracker))
    (rejected,) = [event for event in events if event.kind is EventKind.REJECTED]
    assert rejected.time == 0.61
    assert "0.61.jpg" in rejected.reason
    assert str(fault) in rejected.reason
    assert tracker.state(1).hits == 5


def test_a_fault_of_the_program_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError):
        list(stream(drive(), Eye({0.61: ZeroDivisionError()}), PalletTracker()))


def test_a_shot_waits_until_odometry_reaches_it() -> None:
    eye, tracker = Eye(), PalletTracker()
    given: list[Given] = [shot(0.9), sample(0.0), sample(0.2), sample(0.5), sample(0.95)]
    events = list(stream(given, eye, tracker))
    assert eye.asked == [0.9]
    assert eye.poses[0].x == pytest.approx(0.45, abs=1e-3)
    assert kinds(events)[0] is EventKind.WAITING
    assert tracker.state(1).hits == 1


def test_odometry_that_never_comes_rejects_the_shots_and_holds_only_some() -> None:
    eye = Eye()
    times = [0.1 * number for number in range(MOST_HELD + 3)]
    events = []
    held = 0
    for event in stream(map(shot, times), eye, PalletTracker()):
        held += {EventKind.WAITING: 1, EventKind.REJECTED: -1}[event.kind]
        assert held <= MOST_HELD + 1
        events.append(event)
    assert eye.asked == []
    assert [event.time for event in events if event.kind is EventKind.REJECTED] == times
    assert all("no odometry" in event.reason for event in events)


def test_a_shot_that_odometry_has_passed_without_a_pose_is_given_up() -> None:
    given: list[Given] = [shot(0.0), *(sample(5.0 + 0.1 * number) for number in range(5))]
    events = list(stream(given, Eye(), PalletTracker()))
    assert [event.time for event in events if event.kind is EventKind.REJECTED] == [0.0]


@pytest.mark.parametrize("time", [0.5, float("nan"), float("inf"), 1e9])
def test_a_shot_that_comes_too_late_or_never_was_costs_no_work(time: float) -> None:
    eye, tracker = Eye(), PalletTracker()
    given: list[Given] = [*(sample(0.1 * number) for number in range(40)), CameraShot(time, DARK)]
    events = [event for event in stream(given, eye, tracker) if event.kind is not EventKind.ACCEPTED]
    assert eye.asked == []
    assert events[-1].kind in (EventKind.TOO_LATE, EventKind.REJECTED)


def test_a_latency_is_taken_off_before_odometry_is_asked() -> None:
    eye = Eye()
    tracker = PalletTracker(TrackerConfig(errors=MeasurementErrors(latency_s=0.1)))
    list(stream([sample(0.0), sample(0.5), sample(1.0), shot(0.9)], eye, tracker))
    assert eye.poses[0].x == pytest.approx(0.4, abs=1e-3)


def test_a_recording_comes_in_order_of_arrival() -> None:
    recording = read_recording(SAMPLE)
    for delay in (0.0, 0.31):
        arrived = list(RecordingSource(recording, delay))
        at = [each.time + (delay if isinstance(each, CameraShot) else 0.0) for each in arrived]
        assert at == sorted(at)
        shots = [each for each in arrived if isinstance(each, CameraShot)]
        assert [(shot.time, shot.file) for shot in shots] == [(shot.time, shot.file) for shot in recording.shots]
        assert len(arrived) == len(recording.shots) + len(recording.odometry.times)
    assert (shots[2].load() == recording.image(recording.shots[2])).all()


class Stand(Localizer):
    """Notes where the shelf is said to be."""

    def __init__(self) -> None:
        super().__init__(read_recording(SAMPLE).models)
        self.shelves: list[ShelfPlane] = []
        self.shots: list[tuple[tuple[int, ...], float, str]] = []

    def localize(self, shot: Shot, shelf: ShelfPlane) -> list[PalletMeasurement]:
        self.shelves.append(shelf)
        self.shots.append((shot.image.shape, shot.time, shot.file))
        return []


def test_the_shelf_is_where_odometry_says_with_the_drift_it_may_have() -> None:
    recording, stand = read_recording(SAMPLE), Stand()
    localizer = ShelfLocalizer(
        stand, recording.camera, recording.mounting, recording.shelf, recording.odometry.span[0]
    )
    list(stream(RecordingSource(recording), localizer, PalletTracker()))
    for shelf, one in zip(stand.shelves, recording.shots, strict=True):
        expected = recording.shelf_at(one.time, stand.config.prior)
        assert [shelf.x, shelf.y, shelf.facing] == pytest.approx([expected.x, expected.y, expected.facing], abs=3e-3)
        assert shelf.drift == expected.drift
        assert shelf.levels == recording.shelf.levels
    camera = recording.camera
    assert stand.shots == [((camera.height, camera.width, 3), shot.time, shot.file) for shot in recording.shots]


def test_without_a_time_the_drift_counts_from_the_first_shot() -> None:
    recording, stand = read_recording(SAMPLE), Stand()
    localizer = ShelfLocalizer(stand, recording.camera, recording.mounting, recording.shelf)
    list(stream(RecordingSource(recording), localizer, PalletTracker()))
    assert stand.shelves[0].drift == 0.0 < stand.shelves[-1].drift


def test_the_example_follows_the_pallets_of_the_sample(capsys: pytest.CaptureFixture[str]) -> None:
    """Three pallets stand there; each is seen in the last shot, about where a single shot puts it."""
    page = (Path(__file__).resolve().parents[2] / "examples" / "plot_05_stream.py").read_text(encoding="utf-8")
    first = page.split("# %%")[1]
    lines = [line for line in first.splitlines() if line and not line.startswith("#")]
    made: dict[str, Any] = {}
    exec(compile("\n".join(lines), "example", "exec"), made)
    printed = capsys.readouterr().out.splitlines()
    recording, tracker = made["recording"], made["tracker"]
    last = recording.shots[-1]
    single = made["localizer"].localizer.localize(recording.shot(last), recording.shelf_at(last.time))
    states = tracker.tracks(last.time)
    assert sum(line.endswith(" born") for line in printed) == len(states)
    for each in single:
        place = each.forklift_from_pallet.as_array()[:3]
        assert min(np.linalg.norm(state.pose.as_array()[:3] - place) for state in states) < 0.05
