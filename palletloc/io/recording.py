"""A recording: one approach in a folder, with its shots, odometry, camera and shelf."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.errors import PalletLocError
from palletloc.geometry import Image, wrap_angle
from palletloc.io.atomic import write_text, written_beside
from palletloc.io.camera_spec import (
    angles_from_transform,
    camera_from_spec,
    degrees,
    is_panorama,
    spec_from_camera,
    transform_from_angles,
)
from palletloc.io.csv_table import TableError, format_number, in_order_of_time, read_rows, write_rows
from palletloc.io.images import read_image, write_image
from palletloc.io.measurements import format_time
from palletloc.io.odometry_check import in_seconds
from palletloc.io.path_file import read_odometry
from palletloc.io.path_frame import PathForm, path_form
from palletloc.io.reading import InputError, read_bytes
from palletloc.io.schema import MountingSpec, OdometrySpec, RecordingSpec, ShelfSpec
from palletloc.io.truth import Truth, write_truth
from palletloc.io.yaml_document import DocumentError, read_document, write_document
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.pallet_library import find_models, format_pallets, read_pallets
from palletloc.prior import PriorConfig
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot
from palletloc.trajectory import Trajectory, TrajectoryError

RECORDING, PALLETS, SHOTS, ODOMETRY = "recording.yaml", "pallets.yaml", "shots.csv", "odometry.csv"
"""Names of the files in the folder."""
SHOT_COLUMNS = ("time_s", "file")
"""Header of shots.csv."""
_ODOMETRY_COLUMNS = ("time_s", "x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps")
"""Header of odometry.csv."""
_MIN_SHELF_DISTANCE = 0.2
"""Closest that the camera may be to the shelf's front plane, in metres."""


class ShotError(PalletLocError):
    """A shot that cannot be used although its image can be read; names the file and what was expected."""


@dataclass(frozen=True, slots=True)
class ShotFile:
    """An image in its file, with its time: a row of shots.csv."""

    time: float
    """When it was exposed, in seconds."""
    file: str
    """Its file, relative to the recording."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The content of a recording's folder; the images stay in their files until they are asked for."""

    folder: Path
    """Where it is."""
    camera: CameraModel
    """The camera."""
    forklift_from_camera: RigidTransform
    """Its mounting."""
    shelf: ShelfPlane
    """The nominal front plane of the shelf, in odom."""
    models: tuple[PalletModel, ...]
    """The pallets to look for."""
    shots: tuple[ShotFile, ...]
    """In order of time."""
    odometry: Trajectory
    """``odom_from_forklift``, with speed and yaw rate."""
    translation_sigma: tuple[float, float, float] | None = None
    """Standard deviations of the mounting along the forklift's axes, in metres; None where unknown."""
    rotation_sigma: tuple[float, float, float] | None = None
    """Standard deviations of the mounting about the forklift's axes, in radians; None where unknown."""
    odometry_file: str = ODOMETRY
    """File of the odometry, relative to the folder."""
    truth_form: PathForm = field(default_factory=PathForm)
    """What the file of the forklift's true path cannot say itself."""
    notes: tuple[str, ...] = ()
    """What was strange, dropped or assumed when the files were read, one line each."""

    @property
    def mounting(self) -> Mounting:
        """The mounting with its uncertainty; where that is unknown, the one that `Mounting` assumes."""
        mounting = Mounting(self.forklift_from_camera)
        return replace(
            mounting,
            translation_sigma=self.translation_sigma or mounting.translation_sigma,
            rotation_sigma=self.rotation_sigma or mounting.rotation_sigma,
        )

    def image(self, shot: ShotFile, *, gray: bool = False) -> Image:
        """Read and decode the image of a shot; it is not kept.

        Parameters
        ----------
        shot : ShotFile
            One of the recording's.
        gray : bool
            Whether to decode to gray.

        Returns
        -------
        (height, width, 3) or (height, width) array of uint8
            In blue-green-red order, or gray.

        Raises
        ------
        ImageError
            If the file is missing, damaged, too large, or not of the camera's size.
        """
        size = (self.camera.width, self.camera.height)
        return read_image(self.folder / shot.file, size, gray=gray, panorama=is_panorama(self.camera))

    def __iter__(self) -> Iterator[Shot]:
        """Yield the shots in order of time, each with its image.

        Raises
        ------
        ImageError
            If an image cannot be read.
        """
        return map(self.shot, self.shots)

    def shot(self, entry: ShotFile) -> Shot:
        """Return a shot with its image, which is read now and not kept.

        Parameters
        ----------
        entry : ShotFile
            One of the recording's.

        Raises
        ------
        ImageError
            If the image cannot be read.
        """
        return Shot(self.image(entry), self.camera, self.mounting, entry.time, entry.file)

    def shelf_at(self, time: float, prior: PriorConfig | None = None) -> ShelfPlane:
        """Carry the nominal shelf plane to a time by odometry.

        Parameters
        ----------
        time : float
            In seconds.
        prior : PriorConfig, optional
            How fast the odometry's heading may drift.

        Returns
        -------
        ShelfPlane
            In the forklift frame at that time, with the drift that the heading may have by then.

        Raises
        ------
        ShotError
            If the odometry does not reach that time.
        """
        try:
            odom_from_forklift = self.odometry.pose_at(time)
        except TrajectoryError as error:
            raise ShotError(f"{self.folder / self.odometry_file}: {error}") from error
        start, _ = self.odometry.span
        return self.shelf.seen_from(odom_from_forklift, (prior or PriorConfig()).drift_after(time - start))

    def digest(self) -> str:
        """Return a short text that changes when the files do (images aside) or the pallet models."""
        digest = hashlib.sha256(repr(self.models).encode())
        for name in (RECORDING, SHOTS, self.odometry_file):
            digest.update(hashlib.sha256(read_bytes(self.folder / name)).digest())
        return digest.hexdigest()[:16]


def read_recording(folder: str | Path) -> Recording:
    """Read a recording, except for its images and its truth.

    Parameters
    ----------
    folder : str or Path
        With recording.yaml, shots.csv, odometry.csv, and pallets.yaml where the user has own models.

    Returns
    -------
    Recording
        Checked; see `check_shelf` for what needs all of it.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong; names file, line or key and what was expected.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a recording with {RECORDING} in it")
    path = folder / RECORDING
    spec = read_document(path, RecordingSpec)
    mounting = spec.forklift_from_camera
    try:
        camera = camera_from_spec(spec.camera)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from error
    notes: list[str] = []
    models, where = _read_models(folder, spec.pallets), spec.odometry or OdometrySpec()
    odometry = read_odometry(folder / where.file, _ODOMETRY_COLUMNS, path_form(folder, where))
    shots = _read_shots(folder / SHOTS, notes)
    return Recording(
        folder,
        camera,
        transform_from_angles(mounting.translation_m, mounting.roll_pitch_yaw_deg),
        _shelf(spec.shelf),
        models,
        shots,
        odometry.trajectory,
        mounting.translation_sigma_m,
        _scaled(mounting.rotation_sigma_deg, np.pi / 180),
        where.file,
        path_form(folder, spec.truth),
        (*odometry.notes, *notes),
    )


def _shelf(spec: ShelfSpec) -> ShelfPlane:
    return ShelfPlane(*spec.point_m, wrap_angle(float(np.radians(spec.facing_deg))), spec.levels_m or ())


def _scaled(values: tuple[float, float, float] | None, factor: float) -> tuple[float, float, float] | None:
    return None if values is None else (values[0] * factor, values[1] * factor, values[2] * factor)


def _read_models(folder: Path, names: tuple[str, ...]) -> tuple[PalletModel, ...]:
    path = folder / PALLETS
    user = read_pallets(path) if path.exists() else {}
    try:
        return find_models(names, user)
    except PalletLocError as error:
        raise DocumentError(f"{folder / RECORDING}: pallets: {error}") from error


def _read_shots(path: Path, notes: list[str]) -> tuple[ShotFile, ...]:
    rows = in_order_of_time(in_seconds(read_rows(path, SHOT_COLUMNS)), notes=notes)
    shots = tuple(ShotFile(row.number("time_s"), row.text("file")) for row in rows)
    if not shots:
        raise TableError(f"{path}: has no rows; expected at least one shot")
    return shots


def check_shelf(recording: Recording) -> None:
    """Check that the camera is in front of the shelf at the first shot.

    Raises
    ------
    DocumentError
        If the plane passes through the camera or faces away from it; names the key.
    TrajectoryError
        If the odometry does not cover the first shot.
    """
    odom_from_forklift = recording.odometry.pose_at(recording.shots[0].time).transform()
    x, y, _ = odom_from_forklift.apply(recording.forklift_from_camera.translation)
    shelf = recording.shelf
    distance = float((x - shelf.x) * np.cos(shelf.facing) + (y - shelf.y) * np.sin(shelf.facing))
    if distance < _MIN_SHELF_DISTANCE:
        where = "behind the plane" if distance <= -_MIN_SHELF_DISTANCE else "on the plane"
        raise DocumentError(
            f"{recording.folder / RECORDING}: shelf: at the first shot the camera is {where},"
            f" {distance:.2f} m in front of it; expected at least {_MIN_SHELF_DISTANCE} m"
            " on the side that facing_deg points to"
        )


def write_recording(
    folder: str | Path, recording: Recording, images: Iterable[Image], truth: Truth | None = None
) -> None:
    """Write a recording, whole or not at all.

    Parameters
    ----------
    folder : str or Path
        Does not exist yet, or is empty. The recording's own folder plays no part.
    recording : Recording
        What `read_recording` reads back; numbers of the odometry have six decimals.
    images : iterable of (height, width, 3) or (height, width) arrays of uint8
        One per shot, in order; taken and written one by one.
    truth : Truth, optional
        To be written with it.

    Raises
    ------
    OutputError
        If it cannot be written, or the folder has something in it.
    ValueError
        If there is another number of images than of shots, one is not of the camera's size, or its file
        lies outside the folder.
    """
    with written_beside(Path(folder)) as partial:
        write_document(partial / RECORDING, _spec(recording))
        write_text(partial / PALLETS, format_pallets(recording.models))
        shots = ((format_time(shot.time), shot.file) for shot in recording.shots)
        write_rows(partial / SHOTS, SHOT_COLUMNS, shots)
        write_rows(partial / ODOMETRY, _ODOMETRY_COLUMNS, _odometry_rows(recording.odometry))
        for shot, image in zip(recording.shots, images, strict=True):
            if image.shape[:2] != (recording.camera.height, recording.camera.width):
                raise ValueError(f"{shot.file}: the image has the shape {image.shape}, not the camera's size")
            if Path(shot.file).is_absolute() or ".." in Path(shot.file).parts:
                raise ValueError(f"{shot.file}: expected a file inside the recording")
            write_image(partial / shot.file, image)
        if truth is not None:
            write_truth(partial, truth)


def _spec(recording: Recording) -> RecordingSpec:
    translation, angles = angles_from_transform(recording.forklift_from_camera)
    rotation_sigma = recording.rotation_sigma
    shelf = recording.shelf
    return RecordingSpec(
        format=1,
        camera=spec_from_camera(recording.camera),
        forklift_from_camera=MountingSpec(
            translation_m=translation,
            roll_pitch_yaw_deg=angles,
            translation_sigma_m=recording.translation_sigma,
            rotation_sigma_deg=None if rotation_sigma is None else tuple(degrees(s) for s in rotation_sigma),
        ),
        shelf=ShelfSpec(point_m=(shelf.x, shelf.y), facing_deg=degrees(shelf.facing), levels_m=shelf.levels or None),
        pallets=tuple(model.name for model in recording.models),
    )


def _odometry_rows(odometry: Trajectory) -> Iterable[list[str]]:
    if odometry.speed is None or odometry.yaw_rate is None:
        raise ValueError("a recording's odometry needs speed and yaw rate")
    columns = (odometry.x, odometry.y, wrap_angle(odometry.yaw), odometry.speed, odometry.yaw_rate)
    for time, *values in zip(odometry.times, *columns, strict=True):
        yield [format_time(float(time)), *(format_number(float(value)) for value in values)]
