"""
A camera and odometry of your own
=================================

Track pallets with any camera that OpenCV opens and odometry that arrives as lines of text. Copy this program and put
your own sources into it::

    python examples/live_camera.py SETUP --video 0 --odometry /dev/stdin --latency 0.25
    python examples/live_camera.py SETUP --video drive.mp4 --odometry odometry.csv --start 12.5

SETUP is any recording of this forklift: its recording.yaml says what the camera is, how it is mounted, where the
shelf is in the odometry's frame, and which pallets to look for; its images are not read. Each line of the odometry is
``time_s,x_m,y_m,yaw_rad``; what follows is passed over, and so is a header. A video's first frame has the time that
--start gives; a camera's frames have the time at which they come, minus its latency, by the clock of Python's
``time.time``. The odometry has to use the same clock.
"""

from __future__ import annotations

import argparse
import heapq
import queue
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from palletloc import Localizer, PalletLocError, read_recording
from palletloc.geometry import LevelPose
from palletloc.io.recording import Recording
from tracking import Odometry, PalletTracker, ShelfLocalizer, stream
from tracking.events import Event
from tracking.streaming import CameraShot

# %%
# A source of shots. A frame is taken every so many seconds: the localizer needs a tenth of a second for one, and
# between the shots the odometry knows where the pallets are.


class Capture(Protocol):
    """What is used of ``cv2.VideoCapture``."""

    def read(self) -> tuple[bool, np.ndarray]:
        """Return whether there is a frame, and the frame."""

    def get(self, name: int) -> float:
        """Return a property."""


def video_shots(capture: Capture, every: float, start: float) -> Iterator[CameraShot]:
    """Yield frames of a video file; the first one has the time ``start``."""
    first: float | None = None
    following = start
    while True:
        found, image = capture.read()
        if not found:
            return
        seconds = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        first = seconds if first is None else first
        now = start + seconds - first
        if now >= following - 1e-6:
            following = now + every
            yield CameraShot(now, image, f"frame at {now:.3f} s")


def camera_shots(capture: Capture, every: float, latency: float) -> Iterator[CameraShot]:
    """Yield frames of a camera as they come; ends when the camera does."""
    following = -np.inf
    while True:
        found, image = capture.read()
        now = time.time() - latency
        if not found:
            return
        if now >= following:
            following = now + every
            yield CameraShot(now, image, f"frame at {now:.3f} s")


# %%
# A source of odometry: here lines of text; put your bus or your ROS topic in its place.


def odometry_samples(lines: Iterable[str], name: str) -> Iterator[Odometry]:
    """Yield a sample for each line ``time_s,x_m,y_m,yaw_rad``."""
    for number, line in enumerate(lines, start=1):
        cells = line.replace(",", " ").split()
        if not cells or (number == 1 and cells[0].isidentifier()):
            continue
        try:
            stamp, x, y, yaw = (float(cell) for cell in cells[:4])
        except ValueError:
            told = f"expected time_s,x_m,y_m,yaw_rad, got {line.strip()!r}"
            raise PalletLocError(f"{name}, line {number}: {told}") from None
        yield Odometry(stamp, LevelPose(x, y, 0.0, yaw))


# %%
# Both together. What was recorded is merged by time, so that nothing is lost; what is live comes from a thread each,
# and a shot that finds the localizer busy is dropped: an old shot helps less than the next one.


def merged(shots: Iterable[CameraShot], odometry: Iterable[Odometry]) -> Iterator[Odometry | CameraShot]:
    """Yield both in the order of their times, odometry first where these are equal."""
    both: tuple[Iterable[Odometry | CameraShot], ...] = (odometry, shots)
    yield from heapq.merge(*both, key=lambda given: given.time)


Waiting = queue.Queue[Odometry | CameraShot | Exception | None]


def put(source: Iterable[Odometry | CameraShot], waiting: Waiting, busy: threading.Event) -> None:
    """Let what a source gives wait in a queue, shots only while none is worked on, and its end or its error."""
    try:
        for given in source:
            if not isinstance(given, CameraShot):
                waiting.put(given)
            elif not busy.is_set():
                busy.set()
                waiting.put(given)
    except Exception as error:  # noqa: BLE001 - raised again where the stream is read
        waiting.put(error)
    waiting.put(None)


def arriving(shots: Iterable[CameraShot], odometry: Iterable[Odometry]) -> Iterator[Odometry | CameraShot]:
    """Yield both as they come, until both have ended."""
    waiting: Waiting = queue.Queue(maxsize=1000)
    busy = threading.Event()
    for source in (shots, odometry):
        threading.Thread(target=put, args=(source, waiting, busy), daemon=True).start()
    running = 2
    while running:
        given = waiting.get()
        if isinstance(given, Exception):
            raise given
        if given is None:
            running -= 1
            continue
        yield given  # comes back here when the shot has been localized
        if isinstance(given, CameraShot):
            busy.clear()


# %%
# The loop is that of a recording. Events say what became of every input.


def follow(
    setup: Recording, source: Iterable[Odometry | CameraShot], tracker: PalletTracker | None = None
) -> Iterator[Event]:
    """Track the pallets that a source shows, and print where they are after each shot."""
    localizer = ShelfLocalizer(Localizer(setup.models), setup.camera, setup.mounting, setup.shelf)
    tracker = tracker or PalletTracker(models=setup.models)
    for event in stream(source, localizer, tracker):
        if event.kind == "rejected":
            print(f"{event.time:.2f} s: {event.reason}", file=sys.stderr)
        elif event.kind == "accepted" and event.track is not None:
            found = tracker.state(event.track, at=event.time)
            sigma = 1000 * np.sqrt(np.diag(found.covariance))
            where = f"{found.pose.x:.3f} {found.pose.y:.3f} {found.pose.z:.3f} m"
            yaw = f"{np.degrees(found.pose.yaw):.2f} degrees"
            print(f"{event.time:.2f} s track {found.track}: {where} (sigma {max(sigma[:3]):.0f} mm), {yaw}")
        yield event


def main(arguments: list[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    parser = argparse.ArgumentParser(description="Track pallets with a camera and odometry of your own.")
    parser.add_argument("setup", type=Path, help="a recording of this forklift")
    parser.add_argument("--video", required=True, help="number of a camera, or a video file")
    parser.add_argument("--odometry", type=Path, required=True, help="lines time_s,x_m,y_m,yaw_rad")
    parser.add_argument("--every", type=float, default=0.5, help="seconds between shots")
    parser.add_argument("--start", type=float, default=0.0, help="time of a video's first frame, in seconds")
    parser.add_argument("--latency", type=float, default=0.0, help="how late a camera's frames come, in seconds")
    options = parser.parse_args(arguments)
    live = options.video.isdigit()
    capture = cv2.VideoCapture(int(options.video) if live else options.video)
    try:
        if not capture.isOpened():
            raise PalletLocError(f"--video {options.video}: cannot be opened")
        setup = read_recording(options.setup)
        with options.odometry.open(encoding="utf-8") as lines:
            odometry = odometry_samples(lines, str(options.odometry))
            if live:
                source = arriving(camera_shots(capture, options.every, options.latency), odometry)
            else:
                source = merged(video_shots(capture, options.every, options.start), odometry)
            for _ in follow(setup, source):
                pass
    except (PalletLocError, OSError) as error:
        print(f"live_camera: {error}", file=sys.stderr)
        return 1
    finally:
        capture.release()
    return 0


if __name__ == "__main__":
    sys.exit(main())
