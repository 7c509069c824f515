"""Where the camera and the shelf are: the mounting on the forklift, the lenses, and the shelf's front plane.

Printed targets and what shots show of them; the camera's pose on the forklift from a survey, its check by a drive or
by what is plumb and level, and its plan before anyone drives; the lenses' parameters, and camera files of other
programs; the shelf's front from a drive past it. It imports nothing but `palletloc`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from palletloc.lazy import late_names

if TYPE_CHECKING:
    from calibration.check.assessment import check_mounting as check_mounting
    from calibration.findings import Finding as Finding
    from calibration.formats.convert import convert_camera as convert_camera
    from calibration.intrinsics.fit import calibrate_lenses as calibrate_lenses
    from calibration.motion.assessment import calibrate_motion as calibrate_motion
    from calibration.mounting.assessment import calibrate_mounting as calibrate_mounting
    from calibration.plan.assessment import plan_targets as plan_targets
    from calibration.shelf.assessment import calibrate_shelf as calibrate_shelf

__getattr__ = late_names(__name__, __file__)
"""Imports a name at its first use: a command's help, and what needs a part of the package, load no more than that."""
