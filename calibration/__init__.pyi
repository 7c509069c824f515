from calibration.check.assessment import check_mounting as check_mounting
from calibration.findings import Finding as Finding
from calibration.formats.convert import convert_camera as convert_camera
from calibration.intrinsics.fit import calibrate_lenses as calibrate_lenses
from calibration.motion.assessment import calibrate_motion as calibrate_motion
from calibration.mounting.assessment import calibrate_mounting as calibrate_mounting
from calibration.plan.assessment import plan_targets as plan_targets
from calibration.shelf.assessment import calibrate_shelf as calibrate_shelf
