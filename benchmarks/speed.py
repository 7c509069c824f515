"""How long the steps take: CPU time of one thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.memory import peak_memory
from benchmarks.stopwatch import Timings, joined, take_turns
from benchmarks.tables import Column, Section, Value
from palletloc.choices import Method
from palletloc.detection import detect
from palletloc.errors import PalletLocError
from palletloc.geometry import LevelPose
from palletloc.io.recording import Recording, read_recording
from palletloc.localizer import Localizer, Start
from palletloc.measurement import YawSource
from palletloc.plane import PlaneGrid
from palletloc.projection import Interpolation
from palletloc.recording_run import read_job
from palletloc.remap_table import build_table
from palletloc.report.overview_page import thumbnail
from palletloc.shot import Shot

MAX_SHOTS = 6
"""Most shots to measure on, spread over the recording."""
MAX_PALLETS = 6
"""Most pallets to measure from given starts."""
START_ERROR = np.array([0.05, 0.05, 0.0, np.radians(3.0)])
"""How far the starts are off (largest x, y, z in metres, yaw in radians)."""
LENGTHS = (24, 96)
"""About how many shots the recordings of the memory measurement have."""

_COLUMNS = (Column("what"), Column("median", 1), Column("unit"), Column("ratio", 1), Column("meaning"))


@dataclass(frozen=True, slots=True)
class Target:
    """A pallet to measure from a given start."""

    shot: Shot
    """The shot."""
    start: Start
    """Off by centimetres and degrees."""


def measure_speed(folder: Path, rounds: int, console: Console) -> list[Section]:
    """Measure speed and memory on a recording.

    Parameters
    ----------
    folder : Path
        The recording.
    rounds : int
        How often everything is timed.
    console : Console
        Shows progress.

    Returns
    -------
    list of Section
        One table.

    Raises
    ------
    PalletLocError
        If the recording cannot be read, or no pallet is found in it.
    """
    recording = read_recording(folder)
    memory = _memory_rows(recording)  # first, while this process is small
    picked = np.unique(np.linspace(0, len(recording.shots) - 1, MAX_SHOTS).round().astype(int))
    shots = [
        _shot_timings(recording, int(number), rounds)
        for number in track(picked, "shots", console=console, transient=True, disable=not console.is_terminal)
    ]
    targets = _targets(recording, [int(number) for number in picked])
    pallets = [
        _pallet_timings(recording, target, rounds)
        for target in track(targets, "pallets", console=console, transient=True, disable=not console.is_terminal)
    ]
    planes = _plane_timings(recording, rounds)
    size = f"{recording.camera.width} x {recording.camera.height}"
    rows = [*_step_rows(joined(shots), planes, size), *_method_rows(joined(pallets)), *memory]
    note = f"CPU time in one thread; medians of {rounds} rounds over {len(picked)} shots and {len(targets)} pallets."
    return [Section(f"Speed on {folder.name}", _COLUMNS, tuple(rows), note)]


def _shot_timings(recording: Recording, number: int, rounds: int) -> Timings:
    entry, job = recording.shots[number], read_job(recording.folder)
    image, config = recording.image(entry), job.localizer.config.detection
    shelf = recording.shelf_at(entry.time)

    def look() -> None:
        # a new shot each time: in a recording none meets the tables of its own planes
        detect(Shot(image, recording.camera, recording.mounting), shelf, recording.models, config)

    def localize() -> None:
        job.explain(number)

    explanation = job.explain(number)
    parts = {"decode": lambda: recording.image(entry), "detect": look, "shot": localize}
    return take_turns({**parts, "thumbnail": lambda: thumbnail(explanation)}, rounds)


def _plane_timings(recording: Recording, rounds: int) -> Timings:
    """Time one megapixel of the shelf's plane: 4 m x 4 m beside the camera."""
    shot = recording.shot(recording.shots[len(recording.shots) // 2])
    image, localizer = shot.image, Localizer(recording.models)
    explained = localizer.explain(shot, recording.shelf_at(shot.time))
    camera_from_plane = explained.shelf_views[0].view.camera_from_plane
    grid = PlaneGrid(left=-2.0, top=3.0, resolution=0.004, columns=1000, rows=1000)
    table = build_table(recording.camera, camera_from_plane, grid)
    return take_turns(
        {
            "map": lambda: build_table(recording.camera, camera_from_plane, grid),
            "remap": lambda: table.apply(image, Interpolation.LINEAR),
        },
        rounds,
    )


def _targets(recording: Recording, numbers: list[int]) -> list[Target]:
    """Return pallets that every method can measure, those that a horizontal plane serves, with starts off."""
    job = read_job(recording.folder)
    rng = np.random.default_rng(0)
    targets = []
    for number in numbers:
        explained = job.explain(number)
        for found in explained.measurements:
            if found.yaw_from is not YawSource.FACE:
                pose = found.forklift_from_pallet.as_array() + START_ERROR * rng.uniform(-1, 1, 4)
                targets.append(Target(explained.shot, Start(found.model, LevelPose(*pose.tolist()))))
    if not targets:
        raise PalletLocError(
            f"{recording.folder}: no pallet found; expected some below or above the camera to measure"
        )
    step = max(1, len(targets) // MAX_PALLETS)
    return targets[::step][:MAX_PALLETS]


def _pallet_timings(recording: Recording, target: Target, rounds: int) -> Timings:
    def measure(method: Method) -> Callable[[], object]:
        def once() -> object:
            shot = replace(target.shot)  # with no table of its planes
            return Localizer(recording.models, method).localize_from(shot, [target.start], recording.shelf.levels)

        return once

    return take_turns({str(method): measure(method) for method in Method}, rounds)


def _step_rows(shots: Timings, planes: Timings, size: str) -> list[tuple[Value, ...]]:
    decode = shots.median("decode")
    return [
        (f"JPEG decode, {size}, colour", 1e3 * decode, "ms per shot", None, None),
        ("map of a plane", 1e3 * planes.median("map"), "ms per Mpx", None, None),
        ("remap, linear, colour", 1e3 * planes.median("remap"), "ms per Mpx", None, None),
        _against_decode("detection", shots, "detect"),
        _against_decode("whole shot with decode", shots, "shot"),
        _against_decode("its thumbnail in the overview", shots, "thumbnail"),
    ]


def _against_decode(title: str, shots: Timings, name: str) -> tuple[Value, ...]:
    return title, 1e3 * shots.median(name), "ms per shot", shots.ratio(name, "decode"), "times the decode"


def _method_rows(pallets: Timings) -> list[tuple[Value, ...]]:
    base = str(Method.JOINT_SEARCH)
    return [
        (
            f"yaw and position, {method}",
            1e3 * pallets.median(str(method)),
            "ms per pallet",
            pallets.ratio(base, str(method)),
            f"times as fast as {base}",
        )
        for method in Method
    ]


def _memory_rows(recording: Recording) -> list[tuple[Value, ...]]:
    shots = len(recording.shots)
    times_each = [max(1, round(length / shots)) for length in LENGTHS]
    peaks = [peak_memory(recording, times) for times in times_each]
    base = peaks[0]
    return [
        (
            f"peak memory, {times * shots} shots",
            None if peak is None else peak / 2**20,
            "MiB",
            None if peak is None or base is None else peak / base,
            f"times that of {times_each[0] * shots} shots",
        )
        for times, peak in zip(times_each, peaks, strict=True)
    ]
