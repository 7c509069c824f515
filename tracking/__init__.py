"""Pallets over time: measurements of single shots fused with the forklift's odometry."""

from __future__ import annotations

from pathlib import Path

from palletloc.lazy import names_of_stub

# Looked up at first use: a command's help, and what needs a part of the package, imports no more than that.
__getattr__ = names_of_stub(__name__, Path(__file__).with_name("__init__.pyi"))
