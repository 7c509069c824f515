import gc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from palletloc import Candidate, Explanation, Fit, LevelPose, Localizer, LocalizerConfig, Method, Refusal, Shot
from palletloc.io.atomic import OutputError
from palletloc.io.csv_table import TableError
from palletloc.io.images import ImageError
from palletloc.io.measurements import NoPose
from palletloc.io.recording import ShotError
from palletloc.io.run_folder import Run, RunFolder
from palletloc.io.yaml_document import DocumentError
from palletloc.measurement import PalletMeasurement, Reason, Stage, YawSource
from palletloc.prior import PriorConfig
from palletloc.recording_run import Job, ShotOutcome, read_job, work_through

RUN = Run(recording="0", method="m", configuration="c", starts="")
PRIOR = PriorConfig(drift_rate_deg_s=0.5, max_drift_deg=0.8)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def starts(folder: Path, *rows: str) -> Path:
    path = folder.parent / "initial.csv"
    path.write_text("".join(f"{row}\n" for row in ("time_s,model,x_m,y_m,z_m,yaw_rad", *rows)))
    return path


def damage(folder: Path, *numbers: int) -> None:
    for number in numbers:
        (folder / "images" / f"{number}.png").write_bytes(b"no image")


def worked(job: Job, out: Path, *, strict: bool = False, resume: bool = False) -> list[ShotOutcome]:
    with RunFolder(out, RUN, job.recording.folder, job.shots, resume=resume) as output:
        return list(work_through(job, output, strict=strict))


def problems(outcomes: Sequence[ShotOutcome]) -> dict[int, str]:
    return {outcome.number: outcome.problem for outcome in outcomes if outcome.problem}


def test_a_shot_is_explained_with_its_image(blank_recording: Path) -> None:
    job = read_job(blank_recording)
    explanation = job.explain(2)
    shot = explanation.shot
    assert shot.image.shape == (32, 64, 3)
    assert np.unique(shot.image).tolist() == [102]
    assert (shot.time, shot.file) == (1.0, "images/2.png")
    assert len(explanation.shelf_views) == 1
    assert job.rows(explanation) == []


def test_the_localizer_is_the_one_that_was_asked_for(blank_recording: Path) -> None:
    sigmas = "translation_sigma_m: [0.001, 0.002, 0.003], rotation_sigma_deg: [0.1, 0.2, 0.3], translation_m"
    edit(blank_recording / "recording.yaml", "translation_m", sigmas)
    config = LocalizerConfig(prior=PRIOR)
    job = read_job(blank_recording, Method.PAPER, config)
    localizer, mounting = job.localizer, job.recording.mounting
    assert (localizer.method, localizer.config, list(localizer.models)) == (Method.PAPER, config, ["t11"])
    assert mounting.translation_sigma == (0.001, 0.002, 0.003)
    np.testing.assert_allclose(np.degrees(mounting.rotation_sigma), [0.1, 0.2, 0.3])
    np.testing.assert_allclose(mounting.center, [0.3, -0.1, 1.8])


def test_given_starts_are_worked_on_in_the_order_of_their_file(blank_recording: Path) -> None:
    path = starts(blank_recording, "1.0,t11,3,2,0.1,1.5", "1.0,t11,4,2,0.9,1.5", "0.5,t11,3,2,0,1.5")
    job = read_job(blank_recording, initial=path)
    assert [shot.file for shot in job.shots] == ["images/2.png", "images/1.png"]
    explanation = job.explain(0)
    assert np.unique(explanation.shot.image).tolist() == [102]
    candidates = [outcome.candidate for outcome in explanation.outcomes]
    assert [candidate.start.x for candidate in candidates] == [3.0, 4.0]
    near, far = (candidate.height for candidate in candidates)
    assert near is not None
    assert (near.z, far) == (0.0, None)  # the recording's only level is at the floor
    assert explanation.shelf_views == ()


def test_each_given_start_has_its_row(blank_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def finds_the_second(self: Localizer, shot: Shot, *_arguments: object) -> Explanation:
        model = self.models["t11"]
        candidates = [Candidate(model, LevelPose(3.0, 2.0, 0.0, float(number))) for number in range(3)]
        first, third = (Refusal(candidate, Stage.YAW, Reason.NO_LINE) for candidate in candidates[::2])
        second = Fit(candidates[1], candidates[1].start, np.eye(4), YawSource.FACE)
        return Explanation(shot, (), (), (first, second, third))

    monkeypatch.setattr(Localizer, "explain_from", finds_the_second)
    job = read_job(blank_recording, initial=starts(blank_recording, *["0.5,t11,3,2,0,1.5"] * 3))
    first, second, third = job.rows(job.explain(0))
    assert first == third == NoPose(0.5, "t11", "images/1.png")
    assert isinstance(second, PalletMeasurement)
    assert (second.forklift_from_pallet.yaw, second.yaw_from) == (1.0, YawSource.FACE)


def test_given_starts_need_no_odometry_at_their_shots(blank_recording: Path) -> None:
    edit(blank_recording / "shots.csv", "1.5,images/3.png", "99,images/3.png")
    job = read_job(blank_recording, initial=starts(blank_recording, "99,t11,3,2,0,1.5"))
    assert len(job.explain(0).outcomes) == 1


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0.5,t1,3,2,0,1.5", "line 3: model: the recording's pallets do not include 't1'; did you mean 't11'?"),
        ("0.5,epal1-800,3,2,0,1", "line 3: model: the recording's pallets do not include 'epal1-800'; known are"),
        ("0.6,t11,3,2,0,1.5", "line 3: time_s: no shot at 0.6 s; the nearest is at 0.5 s"),
        ("0.5,t11,3,nan,0,1.5", "line 3: y_m: expected a finite number, got 'nan'"),
    ],
)
def test_a_bad_start_is_an_error_with_file_and_line(blank_recording: Path, row: str, said: str) -> None:
    path = starts(blank_recording, "0,t11,3,2,0,1.5", row)
    with pytest.raises(TableError) as caught:
        read_job(blank_recording, initial=path)
    assert str(caught.value).startswith(f"{path}, {said}")


@pytest.mark.parametrize("y_m", ["-0.1", "-2.0"])
def test_a_shelf_that_is_not_before_the_camera_ends_the_job(blank_recording: Path, y_m: str) -> None:
    edit(blank_recording / "recording.yaml", "point_m: [3.0, 2.0]", f"point_m: [3.0, {y_m}]")
    with pytest.raises(DocumentError, match=r"recording\.yaml: shelf: at the first shot the camera is"):
        read_job(blank_recording)


def test_every_shot_is_worked_on_and_kept(blank_recording: Path, tmp_path: Path) -> None:
    done = worked(read_job(blank_recording), tmp_path / "out")
    assert [(outcome.number, outcome.shot.file, outcome.problem) for outcome in done] == [
        (number, f"images/{number}.png", "") for number in range(4)
    ]
    assert all(outcome.duration > 0 for outcome in done)


@pytest.mark.parametrize("numbers", [(0,), (2,), (0, 1), (0, 1, 3)])
def test_an_unreadable_shot_is_passed_over(blank_recording: Path, tmp_path: Path, numbers: tuple[int, ...]) -> None:
    damage(blank_recording, *numbers)
    outcomes = worked(read_job(blank_recording), tmp_path / "out")
    assert [outcome.number for outcome in outcomes] == [0, 1, 2, 3]
    assert tuple(problems(outcomes)) == numbers
    for number, problem in problems(outcomes).items():
        assert problem.startswith(f"{blank_recording / 'images' / f'{number}.png'}: is not a JPEG or PNG")


def test_a_shot_that_the_odometry_does_not_reach_is_passed_over(blank_recording: Path, tmp_path: Path) -> None:
    edit(blank_recording / "shots.csv", "0.0,images", "-5,images")
    edit(blank_recording / "shots.csv", "1.5,images", "5,images")
    outcomes = worked(read_job(blank_recording), tmp_path / "out")
    assert tuple(problems(outcomes)) == (0, 3)
    assert all("odometry.csv: no pose at" in problem for problem in problems(outcomes).values())


def test_a_shot_that_is_not_before_the_shelf_is_passed_over(blank_recording: Path, tmp_path: Path) -> None:
    edit(blank_recording / "odometry.csv", "2.0,0.8,0.0,0.2", "2.0,0.8,5.0,0.2")
    outcomes = worked(read_job(blank_recording), tmp_path / "out")
    assert tuple(problems(outcomes)) == (3,)
    assert problems(outcomes)[3].startswith(f"{blank_recording / 'images' / '3.png'}: shelf: the camera is")


@pytest.mark.parametrize("numbers", [(0,), (2,)])
def test_strict_ends_at_the_first_bad_shot(blank_recording: Path, tmp_path: Path, numbers: tuple[int, ...]) -> None:
    damage(blank_recording, *numbers)
    with pytest.raises(ImageError, match=rf"{numbers[0]}\.png: is not"):
        worked(read_job(blank_recording), tmp_path / "out", strict=True)
    assert not (tmp_path / "out" / "measurements.csv").exists()


def test_with_no_usable_shot_a_recording_is_at_fault_or_its_only_shot(blank_recording: Path, tmp_path: Path) -> None:
    damage(blank_recording, 0, 1, 2, 3)
    with pytest.raises(ShotError) as caught:
        worked(read_job(blank_recording), tmp_path / "out")
    first = f"{blank_recording / 'images' / '0.png'}: is not a JPEG or PNG image"
    assert str(caught.value).startswith(f"{blank_recording}: none of 4 shots can be used; the first: {first}")
    assert not (tmp_path / "out").exists()
    (blank_recording / "shots.csv").write_text("time_s,file\n0,images/0.png\n")
    damage(blank_recording, 0)
    with pytest.raises(ShotError) as caught:
        worked(read_job(blank_recording), tmp_path / "out")
    assert str(caught.value).startswith(f"{blank_recording / 'images' / '0.png'}: is not")


def test_what_was_skipped_is_passed_over_again(blank_recording: Path, tmp_path: Path) -> None:
    damage(blank_recording, 1)
    job = read_job(blank_recording)
    worked(job, tmp_path / "out")
    outcomes = worked(job, tmp_path / "out", resume=True)
    assert tuple(problems(outcomes)) == (1,)
    assert len(outcomes) == 1


def test_full_disks_blame_no_shot(blank_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cannot(*_arguments: object) -> None:
        raise OutputError("out: cannot be written: No space left on device")

    monkeypatch.setattr(RunFolder, "add", cannot)
    with pytest.raises(OutputError, match="No space left"):
        worked(read_job(blank_recording), tmp_path / "out")


def test_what_was_found_is_not_piled_up(blank_recording: Path, tmp_path: Path) -> None:
    lines = [f"{0.01 * number:.2f},images/0.png" for number in range(12)]
    (blank_recording / "shots.csv").write_text("\n".join(["time_s,file", *lines]) + "\n")
    job = read_job(blank_recording)
    with RunFolder(tmp_path / "out", RUN, blank_recording, job.shots) as output:
        alive = [sum(isinstance(thing, Explanation) for thing in gc.get_objects()) for _ in work_through(job, output)]
    assert len(alive) == 12
    assert max(alive) <= alive[0] + 1
