from pathlib import Path

import pytest

from palletloc.io.measurements import read_measurements
from palletloc.io.reading import InputError
from palletloc.io.schema import RecordingSpec
from palletloc.io.yaml_document import read_document

SAID = {
    "levels_1e308": r"shelf\.levels_m\[1\]: expected metres from -10 to 50",
    "levels_1e5": r"shelf\.levels_m\[1\]: expected metres from -10 to 50",
    "rotation_sigma_1e308": r"rotation_sigma_deg\[0\]: expected degrees from 0 to 90",
    "translation_-1.7e308": r"translation_m\[0\]: expected metres from -100 to 100",
    "yaml-degrees-minutes": r"shelf\.facing_deg: .*'268:26:35'; is it degrees:minutes:seconds\?.* 268\.443056",
    "yaml_bomb_levels": r"line 9: is not yaml: its references stand for more than",
    "yaml_hex_20000_digits": r"got '0xf+ \.\.\.",
}


@pytest.mark.parametrize("name", SAID)
def test_a_recording_that_cannot_be_meant_is_refused_with_what_is_wrong(shared_data: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"recording\.yaml.*{SAID[name]}"):
        read_document(shared_data / "faults" / name / "recording.yaml", RecordingSpec)


@pytest.mark.parametrize("name", ["evaluate_cov_tiny", "evaluate_cov_xx_zero"])
def test_a_row_whose_covariance_is_none_is_named(shared_data: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"measurements\.csv, line 3: cov_xx to cov_ww: expected a positive semi"):
        read_measurements(shared_data / "faults" / name / "measurements.csv")
