from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from palletloc.geometry import LevelPose
from palletloc.io.csv_table import TableError
from palletloc.io.measurements import NoPose, read_measurements, read_refusals, write_measurements, write_refusals
from palletloc.measurement import PalletMeasurement, Reason, RefusedCandidate, Stage, YawSource

HEADER = (
    "time_s,file,model,x_m,y_m,z_m,yaw_rad,cov_xx,cov_xy,cov_xz,cov_xw,cov_yy,cov_yz,cov_yw,cov_zz,cov_zw,cov_ww"
    ",score,yaw_from"
)
POSE = LevelPose(2.0271234, -1.521, 0.0, -0.25)


def measured(time: float = 0.336842, pose: LevelPose = POSE, covariance: object = None) -> PalletMeasurement:
    matrix = np.diag([4e-6, 9e-6, 1e-6, 1e-6]) if covariance is None else np.array(covariance)
    return PalletMeasurement(time, "t11", pose, matrix, 0.8125, YawSource.BOTTOM, "images/1.jpg")


def test_the_file_is_what_the_documentation_says(tmp_path: Path) -> None:
    covariance = np.arange(16.0).reshape(4, 4)
    write_measurements(tmp_path / "m.csv", [measured(covariance=covariance), NoPose(1.5, "epal", "b,c.jpg")])
    header, row, empty = (tmp_path / "m.csv").read_text().splitlines()
    assert header == HEADER
    assert row == (
        "0.336842,images/1.jpg,t11,2.027123,-1.521000,0.000000,-0.250000,"
        "0.000000e+00,1.000000e+00,2.000000e+00,3.000000e+00,5.000000e+00,6.000000e+00,7.000000e+00,"
        "1.000000e+01,1.100000e+01,1.500000e+01,0.8125,bottom"
    )
    assert empty == '1.5,"b,c.jpg",epal' + "," * 16


coordinates = st.floats(-100, 100)
poses = st.builds(LevelPose, coordinates, coordinates, coordinates, st.floats(-np.pi, np.pi))


@given(st.lists(st.tuples(st.floats(0, 2e9), poses, st.integers(0, 10**6)), max_size=4))
def test_measurements_written_are_measurements_read(values: list[tuple[float, LevelPose, int]]) -> None:
    written: list[PalletMeasurement | NoPose] = [NoPose(3.25, "t11", "images/0.jpg")]
    for time, pose, seed in values:
        root = np.random.default_rng(seed).normal(size=(4, 4))
        written.append(measured(time, pose, root @ root.T))
    with TemporaryDirectory() as folder:
        write_measurements(Path(folder) / "m.csv", written)
        read = read_measurements(Path(folder) / "m.csv")
    assert read[0] == written[0]
    assert len(read) == len(written)
    for before, after in zip(written[1:], read[1:], strict=True):
        assert isinstance(before, PalletMeasurement)
        assert isinstance(after, PalletMeasurement)
        assert (after.time, after.file, after.model) == (before.time, before.file, before.model)
        assert (after.score, after.yaw_from) == (before.score, before.yaw_from)
        difference = after.forklift_from_pallet.as_array() - before.forklift_from_pallet.as_array()
        assert np.abs(difference).max() <= 0.51e-6
        assert_allclose(after.covariance, before.covariance, rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("-1.521000", "", r"line 2: y_m: expected a finite number, got ''"),
        ("-1.521000", "nan", r"line 2: y_m: expected a finite number, got 'nan'"),
        ("4.000000e-06", "-4.000000e-06", r"line 2: cov_xx, .*expected variances"),
        ("bottom", "botom", r"line 2: yaw_from: unknown word 'botom'; did you mean 'bottom'\?"),
        ("t11", "", r"line 2: model: expected a text"),
        ("0.336842", "", r"line 2: time_s: expected a finite number"),
        ("cov_ww", "cov_w", r"line 1: unknown column 'cov_w'"),
    ],
)
def test_a_bad_row_is_an_error_with_file_and_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "measurements.csv"
    write_measurements(path, [measured()])
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(TableError, match=rf"measurements\.csv, {said}"):
        read_measurements(path)


@pytest.mark.parametrize(
    "row",
    [
        measured(pose=LevelPose(1.0, float("nan"), 0.0, 0.0)),
        measured(covariance=np.full((4, 4), np.inf)),
        measured(time=float("nan")),
        NoPose(float("inf"), "t11"),
    ],
)
def test_what_is_not_finite_is_never_written(tmp_path: Path, row: PalletMeasurement | NoPose) -> None:
    with pytest.raises(ValueError, match="finite"):
        write_measurements(tmp_path / "measurements.csv", [row])
    assert list(tmp_path.iterdir()) == []


def test_refusals_written_are_refusals_read(tmp_path: Path) -> None:
    refusals = tuple(
        RefusedCandidate(0.1 * number, "t11", stage, reason, f"images/{number}.jpg")
        for number, (stage, reason) in enumerate((stage, reason) for stage in Stage for reason in Reason)
    )
    write_refusals(tmp_path / "refusals.csv", refusals)
    assert read_refusals(tmp_path / "refusals.csv") == refusals
    assert (tmp_path / "refusals.csv").read_text().startswith("time_s,file,model,stage,reason\n0.0,images/0.jpg,t11,")


def test_an_unknown_reason_names_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "refusals.csv"
    path.write_text("time_s,file,model,stage,reason\n0.0,a.jpg,t11,yaw,no_lines\n")
    with pytest.raises(TableError, match=r"line 2: reason: unknown word 'no_lines'; did you mean 'no_line'\?"):
        read_refusals(path)
