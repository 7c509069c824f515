"""Files in Leica's GSI-8 and GSI-16 formats: lines and their words, every bad line listed with its reason."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from palletloc.evaluation.survey.gsi_word import GsiWord
from palletloc.evaluation.survey.point import LineNote, SurveyError
from palletloc.io.csv_table import shortened
from palletloc.io.reading import InputError, read_bytes

_HEAD = 7
"""Characters of a word before its data."""
_BLOCK_STARTS = ("11", "41")
_LEVEL_INDEX = re.compile(r"33[0-9]|39[0-9]|57[0-9]")
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


@dataclass(frozen=True, slots=True)
class GsiBlock:
    """One line: a measured point, a station, a code."""

    line: int
    """Number of the line in its file, from 1."""
    wide: bool
    """Whether the words have 16 characters of data (GSI-16) instead of 8."""
    words: tuple[GsiWord, ...]
    """The words in the line's order, none twice; the first is a point (11) or a code (41)."""
    closed: bool = True
    """Whether a blank ends the line, as the format wants."""

    def word(self, index: str) -> GsiWord | None:
        """Return the word with an index, or None."""
        return next((word for word in self.words if word.index == index), None)

    def has(self, *indices: str) -> bool:
        """Return whether all of these words are there."""
        return all(self.word(index) is not None for index in indices)


@dataclass(frozen=True, slots=True)
class GsiFile:
    """All lines of a GSI file: each is a block or a rejected line, unless it is empty."""

    path: Path
    """The file."""
    blocks: tuple[GsiBlock, ...]
    """The lines that were read."""
    rejected: tuple[LineNote, ...]
    """The lines that were not, with the reason."""
    notes: tuple[LineNote, ...]
    """Words of the read lines that have no value though they should, with the reason."""


class GsiLineError(ValueError):
    """A line that is not GSI; says why."""


def read_gsi(path: Path) -> GsiFile:
    """Read a GSI file.

    GSI-8 and GSI-16 lines may be mixed; any line ending, a byte-order mark and a missing blank at the end of a line
    are accepted.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    GsiFile
        With every line that is not empty, read or rejected.

    Raises
    ------
    SurveyError
        If no line could be read; says why the first could not.
    InputError
        If the file cannot be read.
    """
    return parse_gsi(path, _decoded(path))


def parse_gsi(path: Path, text: str) -> GsiFile:
    """Read the text of a GSI file, as `read_gsi` does; the path is for messages."""
    blocks: list[GsiBlock] = []
    rejected: list[LineNote] = []
    for number, line in enumerate(re.split(r"\r*\n|\r", text.rstrip("\x1a")), start=1):
        if not line.strip():
            continue
        try:
            blocks.append(parse_line(line, number))
        except GsiLineError as error:
            rejected.append(LineNote(number, str(error)))
    if not blocks:
        why = f", line {rejected[0].line}: {rejected[0].text}" if rejected else ": is empty"
        raise SurveyError(f"{path}{why}; expected lines in GSI form")
    notes = [LineNote(block.line, fault) for block in blocks for word in block.words if (fault := word.fault())]
    return GsiFile(path, tuple(blocks), tuple(rejected), tuple(notes))


def parse_line(line: str, number: int = 1) -> GsiBlock:
    """Read one line.

    Parameters
    ----------
    line : str
        Without its ending.
    number : int
        Its number in the file.

    Returns
    -------
    GsiBlock
        Its words, all of them as they stand there.

    Raises
    ------
    GsiLineError
        If the words do not stand in their columns, or one stands there twice.

    Examples
    --------
    >>> block = parse_line("110001+00000001 21.322+03496940 31..00+00030485 ")
    >>> [word.index for word in block.words], block.words[2].measure()
    (['11', '21', '31'], 30.485)
    """
    body = line.lstrip(" ")
    wide = body.startswith("*")
    body = body[1:] if wide else body
    words = _words(body.rstrip(" "), len(line) - len(line.lstrip(" ")) + wide, 16 if wide else 8)
    if not words:
        raise GsiLineError("has no words")
    if words[0].index not in _BLOCK_STARTS:
        raise GsiLineError(f"starts with word {words[0].index}, expected a point (11) or a code (41)")
    indices = [word.index for word in words]
    twice = next((index for index in indices if indices.count(index) > 1), None)
    if twice is not None:
        raise GsiLineError(f"word {twice} stands there twice")
    return GsiBlock(number, wide, tuple(words), closed=line.endswith(" "))


def _words(body: str, offset: int, width: int) -> list[GsiWord]:
    words = []
    start = 0
    while start < len(body):
        piece = body[start : start + _HEAD + width]
        column = start + offset + 1
        word = _word(piece, column)
        if len(piece) < _HEAD + width:
            raise GsiLineError(
                f"column {column}: word {word.index} has {len(word.data)} of {width} characters of data"
            )
        start += _HEAD + width
        if start < len(body) and body[start] != " ":
            hint = "; the line has no '*' for words of 16 characters" if width == 8 else ""
            raise GsiLineError(
                f"column {start + offset + 1}: expected a blank after word {word.index}, got {body[start]!r}{hint}"
            )
        while start < len(body) and body[start] == " ":
            start += 1
        words.append(word)
    return words


def _word(piece: str, column: int) -> GsiWord:
    head = re.match(r"([0-9]{2})([^ ]{4})([+-])", piece)
    if head is None:
        raise GsiLineError(f"column {column}: expected a word as '31..00+00030485', got {shortened(piece)}")
    # Only levels have indices of three digits; elsewhere a digit in column 3 belongs to a block's number.
    size = 3 if _LEVEL_INDEX.match(piece) else 2
    return GsiWord(piece[:size], piece[size:6], head[3], piece[_HEAD:])


def _decoded(path: Path) -> str:
    content = read_bytes(path)
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise InputError(f"{path}: is not {encoding} text (byte {error.start})") from None
        # Remarks from an instrument's keyboard may have umlauts in its own alphabet.
        text = content.decode("latin-1")
    if "\0" in text:
        raise InputError(f"{path}: is not text, it has zero bytes")
    return text
