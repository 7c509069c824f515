"""Where the camera and the shelf are: the mounting on the forklift, the lenses, and the shelf's front plane.

Printed targets and what shots show of them; the camera's pose on the forklift from a survey, its check by a drive or
by what is plumb and level, and its plan before anyone drives; the lenses' parameters, and camera files of other
programs; the shelf's front from a drive past it. It imports nothing but `palletloc`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.check.assessment import check_mounting
    from calibration.findings import Finding
    from calibration.formats.convert import convert_camera
    from calibration.intrinsics.fit import calibrate_lenses
    from calibration.shelf.assessment import calibrate_shelf

# Loaded at first use: the command line answers `--help` without numpy, scipy and cv2.
_HOMES = {
    "Finding": "findings",
    "calibrate_lenses": "intrinsics.fit",
    "calibrate_shelf": "shelf.assessment",
    "check_mounting": "check.assessment",
    "convert_camera": "formats.convert",
}
"""Where each public name is defined, below `calibration`."""
__all__ = ["Finding", "calibrate_lenses", "calibrate_shelf", "check_mounting", "convert_camera"]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    return getattr(importlib.import_module(f"calibration.{_HOMES[name]}"), name)
