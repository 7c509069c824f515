"""Compare the wheel in a folder with the packages in the source tree, file by file."""

import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("palletloc", "tracking", "calibration")
NEEDED = (*(f"{package}/py.typed" for package in PACKAGES), "palletloc/pallets.yaml")
MAX_BYTES = 12_000_000


def expected_files() -> set[str]:
    """Return the files of the three packages, as a wheel names them."""
    found = (path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in found if "__pycache__" not in path.parts}


def faults(wheel: Path) -> list[str]:
    """Return one line per fault of the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    info = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    content, expected = names - info, expected_files()
    lines = [f"not in the wheel: {name}" for name in sorted(expected - content)]
    lines += [f"does not belong in the wheel: {name}" for name in sorted(content - expected)]
    lines += [f"needed and missing: {name}" for name in NEEDED if name not in content]
    if not any(name.startswith("palletloc/") and name.endswith("/recording.yaml") for name in content):
        lines.append("needed and missing: the sample recording")
    lines += [
        f"needed and missing: {name}"
        for name in ("licenses/LICENSE", "entry_points.txt")
        if not any(entry.endswith(f".dist-info/{name}") for entry in info)
    ]
    if wheel.stat().st_size > MAX_BYTES:
        lines.append(f"{wheel.stat().st_size} bytes, more than {MAX_BYTES}")
    return lines


def main(folder: str) -> int:
    """Print the faults of the folder's only wheel and return the exit code."""
    wheels = list(Path(folder).glob("*.whl"))
    if len(wheels) != 1:
        print(f"{folder}: expected one wheel, found {len(wheels)}")
        return 1
    lines = faults(wheels[0])
    print("\n".join(f"{wheels[0].name}: {line}" for line in lines) or f"{wheels[0].name}: complete")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
