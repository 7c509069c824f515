"""Files with changed bytes: whatever is done to one, its reader reads it or refuses it in one line, and soon."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palletloc.errors import PalletLocError
from palletloc.io.images import read_image
from palletloc.io.path_file import read_path
from palletloc.survey.reading import read_survey
from tests.palletloc.io.test_images import JPEG, KINDS, RESTARTS
from tests.palletloc.io.test_path_file import FILES, OWN, RATES
from tests.palletloc.survey.test_reading import JOBXML, LANDXML, TABLES

PATHS = [make().encode() for make in FILES.values()]
SURVEYS = [text.encode() for text in (*TABLES.values(), LANDXML, JOBXML)]
SURVEYS.append(b"410001+00000021 42....+0000ST01\n110002+000000K1 21.322+00000000 22.322+10000000 31..00+00010000\n")
IMAGES = [JPEG, RESTARTS, *KINDS.values()]
READERS: dict[str, tuple[list[bytes], Callable[[Path], object]]] = {
    "paths": (PATHS, lambda path: read_path(path, OWN, RATES)),
    "surveys": (SURVEYS, lambda path: list(read_survey(path).remarks())),
    "stated columns": (SURVEYS, lambda path: read_survey(path, columns=("P", "E", "N", "H"))),
    "images": (IMAGES, read_image),
}
PIECES = [b"\xff", b"\0", b"1e999", b"nan", b",", b";", b'"', b"\n", b"<", b"-", b"_", b"9" * 40, b"\xff\xd9"]

changes = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 60), st.one_of(st.sampled_from(PIECES), st.binary(max_size=4))),
    min_size=1,
    max_size=6,
)


def changed(content: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """Return the content with parts replaced: each a place, how many bytes go, and what comes."""
    for share, gone, new in edits:
        at = int(share * len(content))
        content = content[:at] + new + content[at + gone :]
    return content


def check(reader: str, seed: int, edits: list[tuple[float, int, bytes]]) -> None:
    contents, read = READERS[reader]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file.csv"
        path.write_bytes(changed(contents[seed % len(contents)], edits))
        said = ""
        try:
            read(path)
        except PalletLocError as error:
            said = str(error)
        assert "\n" not in said


@pytest.mark.parametrize("reader", READERS)
@settings(max_examples=2 * settings().max_examples, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 50), edits=changes)
def test_changed_bytes_are_read_or_refused(reader: str, seed: int, edits: list[tuple[float, int, bytes]]) -> None:
    check(reader, seed, edits)


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
@settings(max_examples=50 * settings().max_examples, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 50), edits=changes)
def test_many_changed_bytes_are_read_or_refused(
    reader: str, seed: int, edits: list[tuple[float, int, bytes]]
) -> None:
    check(reader, seed, edits)
