"""Peak memory of ``palletloc localize`` on recordings of different lengths, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.io.csv_table import write_rows
from palletloc.io.measurements import format_time
from palletloc.io.recording import PALLETS, RECORDING, SHOT_COLUMNS, SHOTS, Recording

ODOMETRY = "odometry.csv"
_BYTES = 1 if sys.platform == "darwin" else 1024


def peak_memory(recording: Recording, shots: int) -> float | None:
    """Return the most memory that localizing a recording of some length takes.

    Parameters
    ----------
    recording : Recording
        Its shots are used again and again, at slightly different times.
    shots : int
        How many to localize.

    Returns
    -------
    float or None
        In bytes; None where the system does not say.

    Raises
    ------
    PalletLocError
        If the command fails.
    """
    if not hasattr(os, "wait4"):
        return None
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "long"
        _lengthen(recording, shots, folder)
        command = [sys.executable, "-m", "palletloc", "localize", str(folder), "--out", str(Path(scratch) / "out")]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise PalletLocError(f"palletloc localize ended with code {process.returncode}; expected 0")
        return float(used.ru_maxrss * _BYTES)


def _lengthen(recording: Recording, shots: int, folder: Path) -> None:
    """Write a recording that shows each image several times, within the time that its odometry covers."""
    folder.mkdir()
    source = recording.folder.resolve()
    for name in (RECORDING, PALLETS, ODOMETRY):
        if (source / name).exists():
            (folder / name).symlink_to(source / name)
    times = np.array([shot.time for shot in recording.shots])
    last = np.median(np.diff(times)) if len(times) > 1 else recording.odometry.margin
    spans = np.append(np.diff(times), min(last, recording.odometry.span[1] + recording.odometry.margin - times[-1]))
    again = -(-shots // len(times))
    rows = [
        (format_time(float(time + span * k / (1000 * again))), str(source / shot.file))
        for shot, time, span in zip(recording.shots, times, spans, strict=True)
        for k in range(again)
    ]
    write_rows(folder / SHOTS, SHOT_COLUMNS, rows[:shots])
