"""Peak memory of ``palletloc localize`` on recordings of different lengths, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from palletloc.errors import PalletLocError
from palletloc.io.csv_table import write_rows
from palletloc.io.measurements import format_time
from palletloc.io.recording import SHOT_COLUMNS, SHOTS, Recording

_APART = 1e-6
_BYTES = 1 if sys.platform == "darwin" else 1024


def peak_memory(recording: Recording, times_each: int) -> float | None:
    """Return the most memory that localizing a recording of some length takes.

    A process starts with the peak of the one that starts it, so this one should still be small.

    Parameters
    ----------
    recording : Recording
        What to localize.
    times_each : int
        How often the recording shows each of its shots.

    Returns
    -------
    float or None
        In bytes; None where the system does not say.

    Raises
    ------
    PalletLocError
        If the command fails.
    """
    if sys.platform == "win32":
        return None
    with tempfile.TemporaryDirectory() as scratch:
        folder, out = Path(scratch) / "long", Path(scratch) / "out"
        _lengthen(recording, times_each, folder)
        command = [sys.executable, "-m", "palletloc", "localize", str(folder), "--out", str(out)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise PalletLocError(f"palletloc localize ended with exit code {process.returncode}; expected 0")
        return float(used.ru_maxrss * _BYTES)


def _lengthen(recording: Recording, times_each: int, folder: Path) -> None:
    """Write a recording that shows each shot several times, a microsecond apart."""
    folder.mkdir()
    for entry in recording.folder.resolve().iterdir():
        if entry.name != SHOTS:
            (folder / entry.name).symlink_to(entry)
    rows = (
        (format_time(shot.time + again * _APART), shot.file)
        for shot in recording.shots
        for again in range(times_each)
    )
    write_rows(folder / SHOTS, SHOT_COLUMNS, rows)
