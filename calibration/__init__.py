"""Where the camera and the shelf are: the mounting on the forklift, the lenses, and the shelf's front plane.

Printed targets and what shots show of them; the camera's pose on the forklift from a survey, its check by a drive or
by what is plumb and level, and its plan before anyone drives; the lenses' parameters, and camera files of other
programs; the shelf's front from a drive past it. It imports nothing but `palletloc`.
"""

from __future__ import annotations

from pathlib import Path

from palletloc.lazy import names_of_stub

# Looked up at first use: a command's help, and what needs a part of the package, imports no more than that.
__getattr__ = names_of_stub(__name__, Path(__file__).with_name("__init__.pyi"))
