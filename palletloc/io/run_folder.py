"""The output folder of a run over many shots, which may be interrupted and resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from palletloc import __version__
from palletloc.io.atomic import Journal, parsed_json, write_text
from palletloc.io.csv_table import Row, TableError, shortened, write_rows
from palletloc.io.folder_lock import locked
from palletloc.io.measurements import (
    MEASUREMENT_COLUMNS,
    REFUSAL_COLUMNS,
    NoPose,
    format_time,
    measurement_cells,
    parse_measurement,
    parse_refusal,
    refusal_cells,
)
from palletloc.io.reading import InputError, read_bytes, read_text
from palletloc.io.recording import Recording, ShotFile
from palletloc.measurement import PalletMeasurement, RefusedCandidate

MEASUREMENTS, REFUSALS, STATUS, JOURNAL = "measurements.csv", "refusals.csv", "run.json", ".unfinished.jsonl"
"""Names of the files in the folder."""


class ResumeError(InputError):
    """The folder holds another run than the one to be resumed."""


@dataclass(frozen=True, slots=True)
class Run:
    """What a run is: two runs with the same values give the same rows."""

    recording: str
    """Digest of what the recording's files say, images aside."""
    method: str
    """Name of the method."""
    configuration: str
    """Digest of all parameters."""
    starts: str
    """Digest of the file of starts; empty where pallets are detected."""
    version: str = __version__
    """Version of the program."""

    @classmethod
    def of(cls, recording: Recording, method: str, configuration: str, starts: Path | None = None) -> Self:
        """Describe a run.

        Parameters
        ----------
        recording : Recording
            The shots.
        method : str
            Name of the method.
        configuration : str
            All parameters, in any textual form that shows every difference.
        starts : Path, optional
            The file of starts.
        """
        return cls(
            recording.digest(),
            method,
            _digest(configuration.encode()),
            "" if starts is None else _digest(read_bytes(starts)),
        )


class RunFolder:
    """Takes the rows of shot after shot, and writes the csv files when the run ends.

    A context manager. Each shot's rows go to a journal in the folder at once. At the end, and on
    KeyboardInterrupt, measurements.csv and refusals.csv appear with the rows of all finished shots, and
    ``run.json`` says what the run is, which shots were skipped and why, and whether it is complete. Any other
    exception leaves the csv files that were there before. The journal stays as long as a shot is left to
    be done or was skipped, so that the run can be resumed.

    Parameters
    ----------
    folder : Path
        Where the files go; made if missing.
    run : Run
        What the run is.
    source : Path
        The recording's folder, to be named in ``run.json``.
    shots : sequence of ShotFile
        What to work through; their rows are written in this order. A shot may stand there more than once.
    resume : bool
        Whether to keep what an earlier run finished, and work on what it skipped or left.

    Raises
    ------
    ResumeError
        If the folder to be resumed holds another run.
    OutputError
        If the folder cannot be written.
    """

    def __init__(
        self, folder: Path, run: Run, source: Path, shots: Sequence[ShotFile], *, resume: bool = False
    ) -> None:
        self._folder = folder
        self._run = run
        self._source = source
        self._shots = tuple(shots)
        self._resume = resume
        self._done: set[int] = set()
        self._skipped: dict[int, str] = {}
        self._damaged = 0
        self._journal: Journal | None = None
        self._open = ExitStack()
        """Holds the lock of the folder."""

    def __enter__(self) -> Self:
        """Make the folder, keep other runs out of it, and find what is finished already."""
        self._open.enter_context(locked(self._folder))
        try:
            return self._found()
        except BaseException:
            self._open.close()
            raise

    def _found(self) -> Self:
        if self._resume and self._is_finished():
            self._done.update(range(len(self._shots)))
            return self
        path = self._folder / JOURNAL
        if self._resume and path.exists():
            self._journal = self._taken_up(path)
            return self
        self._journal = Journal(path, asdict(self._run))
        return self

    @property
    def folder(self) -> Path:
        """Where the files go."""
        return self._folder

    @property
    def done(self) -> int:
        """How many shots are finished, those of the resumed run included."""
        return len(self._done)

    @property
    def damaged(self) -> int:
        """How many entries of the resumed run were damaged; their shots are done again."""
        return self._damaged

    @property
    def skipped(self) -> dict[int, str]:
        """Why shots could not be read, by their number."""
        return dict(self._skipped)

    def remaining(self) -> Iterator[tuple[int, ShotFile]]:
        """Yield the number and shot of everything that is left to do, in order."""
        for number, shot in enumerate(self._shots):
            if number not in self._done:
                yield number, shot

    def add(
        self, number: int, rows: Sequence[PalletMeasurement | NoPose], refusals: Sequence[RefusedCandidate]
    ) -> None:
        """Keep what a shot gave.

        Parameters
        ----------
        number : int
            Of the shot, as `remaining` gives it.
        rows : sequence of PalletMeasurement and NoPose
            Its rows of measurements.csv.
        refusals : sequence of RefusedCandidate
            Its rows of refusals.csv.

        Raises
        ------
        OutputError
            If the journal cannot be written.
        """
        self._append(
            number,
            {
                "measurements": [measurement_cells(row) for row in rows],
                "refusals": [refusal_cells(refusal) for refusal in refusals],
            },
        )

    def skip(self, number: int, reason: str) -> None:
        """Note that a shot could not be worked on, and why; a resumed run tries it again.

        Raises
        ------
        OutputError
            If the journal cannot be written.
        """
        self._append(number, {"skipped": reason})

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the files of what is finished, unless something went wrong."""
        with self._open:
            self._end(self._journal, kind)

    def _end(self, journal: Journal | None, kind: type[BaseException] | None) -> None:
        if journal is None:
            return
        anything = bool(self._done or self._skipped) or not self._shots
        removable = not anything
        try:
            if anything and (kind is None or issubclass(kind, KeyboardInterrupt)):
                self._publish(journal)
                removable = len(self._done) == len(self._shots)
        finally:
            journal.close(remove=removable)

    def _taken_up(self, path: Path) -> Journal:
        journal = Journal(path)
        try:
            self._check_same(journal.heading)
        except ResumeError:
            journal.close(remove=False)
            raise
        for number, entry in journal.entries():
            if self._is_sound(number, entry):
                self._note(number, entry)
            else:
                journal.forget(number)
        self._damaged = journal.damaged
        return journal

    def _is_sound(self, number: int, entry: dict[str, Any]) -> bool:
        """Tell whether an entry is what a run writes of the shot with this number."""
        if not 0 <= number < len(self._shots):
            return False
        if "skipped" in entry:
            return isinstance(entry["skipped"], str)
        shot = self._shots[number]
        parts = (
            (MEASUREMENT_COLUMNS, "measurements", parse_measurement),
            (REFUSAL_COLUMNS, "refusals", parse_refusal),
        )
        return all(
            isinstance(entry.get(part), list) and all(_is_row(cells, columns, shot, parse) for cells in entry[part])
            for columns, part, parse in parts
        )

    def _append(self, number: int, entry: dict[str, Any]) -> None:
        if self._journal is None:
            raise ValueError("the run folder is not open, or its run was finished before")
        self._journal.append(number, entry)
        self._note(number, entry)

    def _note(self, number: int, entry: dict[str, Any]) -> None:
        if "skipped" in entry:
            self._skipped[number] = entry["skipped"]
        else:
            self._done.add(number)
            self._skipped.pop(number, None)

    def _publish(self, journal: Journal) -> None:
        """Write the three files; the status is away while the tables change."""
        (self._folder / STATUS).unlink(missing_ok=True)
        for name, columns, part in (
            (MEASUREMENTS, MEASUREMENT_COLUMNS, "measurements"),
            (REFUSALS, REFUSAL_COLUMNS, "refusals"),
        ):
            rows = (row for _, entry in journal.entries() for row in entry.get(part, ()))
            write_rows(self._folder / name, columns, rows)
        write_text(self._folder / STATUS, json.dumps(self._status(), indent=2) + "\n")

    def _status(self) -> dict[str, Any]:
        skipped = [
            {"time_s": self._shots[number].time, "file": self._shots[number].file, "reason": reason}
            for number, reason in sorted(self._skipped.items())
        ]
        return {
            "complete": len(self._done) + len(skipped) == len(self._shots),
            "shots": len(self._shots),
            "done": len(self._done),
            "skipped": skipped,
            "source": str(self._source),
            "run": asdict(self._run),
        }

    def _is_finished(self) -> bool:
        """Return whether the folder holds this run with every shot done."""
        paths = [self._folder / name for name in (STATUS, MEASUREMENTS, REFUSALS)]
        if not all(path.exists() for path in paths) or (self._folder / JOURNAL).exists():
            return False
        status = parsed_json(read_text(paths[0]))
        run, done = (status.get("run"), status.get("done")) if isinstance(status, dict) else (None, None)
        if isinstance(run, dict) and type(done) is int:
            self._check_same(run)
            if 0 <= done <= len(self._shots):
                return done == len(self._shots)
        raise ResumeError(
            f"{paths[0]}: is not the status of a run; expected one to resume: remove it, or do not resume"
        )

    def _check_same(self, earlier: dict[str, Any]) -> None:
        """Raise an error where the folder holds another run than this one."""
        for name, now in asdict(self._run).items():
            if (before := earlier.get(name)) != now:
                raise ResumeError(
                    f"{self._folder}: cannot resume: the run there had the {name} {shortened(before)}, not {now!r};"
                    " expected the same, or a run that does not resume"
                )


def _is_row(cells: Any, columns: Sequence[str], shot: ShotFile, parse: Callable[[Row], object]) -> bool:
    """Tell whether cells are a row of a table, and of this shot."""
    if not isinstance(cells, list) or len(cells) != len(columns) or not all(isinstance(cell, str) for cell in cells):
        return False
    row = Row(Path(JOURNAL), 1, dict(zip(columns, cells, strict=True)))
    try:
        parse(row)
    except TableError:
        return False
    return (row.cells["time_s"], row.cells["file"]) == (format_time(shot.time), shot.file)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]
