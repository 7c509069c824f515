"""Find pallets on shelves in 360-degree shots and measure their poses, one shot at a time."""

from __future__ import annotations

from pathlib import Path

from palletloc.lazy import names_of_stub

__version__ = "0.1.0"

# Looked up at first use: the command line answers `--help` without numpy, scipy and cv2.
__getattr__ = names_of_stub(__name__, Path(__file__).with_name("__init__.pyi"))
