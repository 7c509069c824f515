from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import Localizer, LocalizerConfig, Method, Mounting, Opening, PalletModel, Shot
from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.geometry import FloatArray, LevelPose
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.synthetic.materials import CARTONS, CEILING, CONCRETES, PAINTS, PLASTERS, PLASTICS, WOODS
from palletloc.synthetic.pallet_solid import PalletBody
from palletloc.synthetic.placing import standing
from palletloc.synthetic.rays import CameraRays, camera_rays
from palletloc.synthetic.rendering import lit, render
from palletloc.synthetic.rig import Sensor, expose
from palletloc.synthetic.scene import Light, Room, Scene, Solid
from tests.palletloc.poses import POSE, Pallets, Photograph, Portrait, WritePallets

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0, 0]}
shelf: {point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0]}
pallets: [t11]
"""
SHOTS = "time_s,file\n" + "".join(f"{0.5 * n},images/{n}.png\n" for n in range(4))
ODOMETRY = """\
time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps
0.0,0.0,0.0,0.0,0.4,0.1
1.0,0.4,0.0,0.1,0.4,0.1
2.0,0.8,0.0,0.2,0.4,0.1
"""
HALL = Room((-7.0, -7.0), (9.0, 8.0), 5.0, CONCRETES[0], PLASTERS[0], CEILING)
LAMPS = Light(
    ((0.3, 0.2, 0.93), (-0.5, -0.4, 0.77), (0.6, -0.5, 0.62), (-0.2, 0.7, 0.68)),
    (0.45, 0.2, 0.2, 0.15),
    sharp=1,
    bounce=0.12,
)
INTO = np.pi / 2
"""Heading into a shelf on the left."""


@pytest.fixture
def blank_recording(tmp_path: Path) -> Path:
    """Return a recording of four shots with nothing to see, written without the code under test."""
    folder = tmp_path / "approach"
    (folder / "images").mkdir(parents=True)
    for name, text in {"recording.yaml": RECORDING, "shots.csv": SHOTS, "odometry.csv": ODOMETRY}.items():
        (folder / name).write_text(text)
    for number in range(4):
        image = np.full((32, 64, 3), 100 + number, np.uint8)
        (folder / "images" / f"{number}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder


@pytest.fixture
def pallet_file(tmp_path: Path) -> WritePallets:
    """Return a function that writes a file of pallet models."""

    def write(content: str | bytes) -> Path:
        path = tmp_path / "pallets.yaml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of recordings that may lie beside the repository."""
    data = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    if not data.is_dir():
        pytest.skip("the shared recordings are not here")
    return data


@pytest.fixture(scope="session")
def epal() -> PalletModel:
    """Return a wooden face, closed below, with edges that are hardly rounded."""
    openings = tuple(Opening(center, 0.022, 0.3825, 0.1) for center in (-0.26375, 0.26375))
    return PalletModel("epal", 1.2, 0.144, 0.8, openings, edge_radius=0.003)


@pytest.fixture(scope="session")
def t11() -> PalletModel:
    """Return a plastic face with rounded edges and corners."""
    openings = tuple(Opening(center, 0.024, 0.29, 0.092, 0.012) for center in (-0.265, 0.265))
    return PalletModel("t11", 1.1, 0.144, 1.1, openings, 0.012, 0.010)


@pytest.fixture(scope="session")
def open_below() -> PalletModel:
    """Return a face whose openings reach the floor."""
    openings = tuple(Opening(center, 0.0, 0.2275, 0.1) for center in (-0.18625, 0.18625))
    return PalletModel("open", 0.8, 0.144, 1.2, openings, edge_radius=0.003)


@pytest.fixture(params=["epal", "t11", "open_below"])
def model(request: pytest.FixtureRequest) -> PalletModel:
    """Return each of the three in turn: closed below, rounded, and open below."""
    found: PalletModel = request.getfixturevalue(request.param)
    return found


@pytest.fixture(scope="session")
def models(epal: PalletModel, t11: PalletModel, open_below: PalletModel) -> tuple[PalletModel, ...]:
    """Return all three."""
    return (epal, t11, open_below)


@pytest.fixture(scope="session")
def whole_view() -> CameraModel:
    """Return a 360-degree camera."""
    return Equirectangular(1920, 960)


@pytest.fixture(scope="session")
def narrow_view() -> CameraModel:
    """Return a small camera, for one pallet."""
    return Pinhole(520, 260, 560.0, 560.0, 259.5, 129.5)


@pytest.fixture(scope="session")
def mounted() -> Callable[..., RigidTransform]:
    """Return a function that places a camera: where it is, and yaw, pitch and roll in degrees."""

    def forklift_from_camera(x: float, y: float, z: float, *angles_deg: float) -> RigidTransform:
        angles = (*angles_deg, 0.0, 0.0, 0.0)[:3]
        return RigidTransform.from_components([x, y, z], Rotation.from_euler("ZYX", angles, degrees=True))

    return forklift_from_camera


def _around(model: PalletModel, pose: LevelPose, loaded: bool) -> list[Solid]:
    """Return a pallet with its load and, above the floor, the beam below it."""
    half, height = model.width / 2, model.height
    moulded = model.edge_radius > 0.006
    solids: list[Solid] = [PalletBody(pose, model, PLASTICS[0] if moulded else WOODS[0], planks=not moulded)]
    if loaded:
        low, high = (0.02, 0.02 - half, height), (model.depth - 0.02, half - 0.02, height + 0.4)
        solids.append(standing(pose, low, high, CARTONS[1], 0.004))
    if pose.z > 0.05:
        solids.append(standing(pose, (0.03, -half - 0.3, -0.12), (0.08, half + 0.3, 0.0), PAINTS[0], 0.004))
    return solids


@pytest.fixture(scope="session")
def photograph() -> Callable[..., Shot]:
    """Return a function that takes pictures of pallets, each picture once."""
    kept: dict[CameraModel, CameraRays] = {}

    @cache
    def taken(
        pallets: Pallets, camera: CameraModel, mounting: tuple[float, ...], loaded: bool = True, seed: int = 0
    ) -> Shot:
        solids = tuple(solid for model, pose in pallets for solid in _around(model, pose, loaded))
        if camera not in kept:
            kept[camera] = camera_rays(camera)
        angles = Rotation.from_euler("ZYX", mounting[3:], degrees=True)
        forklift_from_camera = RigidTransform.from_components(mounting[:3], angles)
        picture = render(lit(Scene(HALL, LAMPS, solids)), kept[camera], forklift_from_camera)
        closed = camera.period_px is not None
        image = expose(picture.radiance, Sensor(), closed, np.random.default_rng(seed))
        image.setflags(write=False)
        return Shot(image, camera, Mounting(forklift_from_camera))

    return taken


@pytest.fixture(scope="session")
def portrait(photograph: Photograph, narrow_view: CameraModel) -> Callable[..., Shot]:
    """Return a function that takes a picture of one pallet with a small camera aimed at it."""

    def aimed(
        model: PalletModel, pose: LevelPose, center: tuple[float, float, float] = (0.3, -0.08, 1.85), seed: int = 0
    ) -> Shot:
        x, y, z = np.array([pose.x, pose.y, pose.z + model.height / 2]) - center
        aim = np.degrees([np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))])
        return photograph(((model, pose),), narrow_view, (*center, *aim.tolist(), 0.8), seed=seed)

    return aimed


@pytest.fixture(params=[22.0, -22.0])
def cut_shot(
    request: pytest.FixtureRequest,
    photograph: Photograph,
    portrait: Portrait,
    narrow_view: CameraModel,
    t11: PalletModel,
) -> Shot:
    """Return a picture whose border cuts the pallet at `POSE`."""
    straight = portrait(t11, POSE).mounting.forklift_from_camera
    yaw, pitch, roll = straight.rotation.as_euler("ZYX", degrees=True).tolist()
    return photograph(((t11, POSE),), narrow_view, (*straight.translation, yaw + request.param, pitch, roll))


@pytest.fixture(scope="session")
def floor_pallets(open_below: PalletModel, t11: PalletModel) -> Pallets:
    """Return two pallets on the floor to the left, each a little turned."""
    return (
        (open_below, LevelPose(0.6, 2.0, 0.0, INTO + np.radians(1.5))),
        (t11, LevelPose(2.1, 2.03, 0.0, INTO - np.radians(2.0))),
    )


@pytest.fixture(scope="session")
def floor_shot(photograph: Photograph, floor_pallets: Pallets, whole_view: CameraModel) -> Shot:
    """Return a 360-degree shot of the pallets on the floor."""
    return photograph(floor_pallets, whole_view, (0.3, -0.08, 1.85, -1.2, 0.9, -0.7))


@pytest.fixture(scope="session")
def floor_localizer(floor_pallets: Pallets) -> Callable[..., Localizer]:
    """Return a function that makes a localizer for the pallets of `floor_shot`."""

    def made(
        method: Method = Method.HORIZONTAL_PLANE,
        models: Sequence[PalletModel] = tuple(model for model, _ in floor_pallets),
        config: LocalizerConfig | None = None,
    ) -> Localizer:
        return Localizer(models, method, config)

    return made


@pytest.fixture(scope="session")
def rack_pallets(t11: PalletModel) -> Pallets:
    """Return a pallet on the floor, one level with the camera of `rack_shot`, and one above it."""
    return (
        (t11, LevelPose(-0.4, 2.0, 0.0, INTO + np.radians(1.0))),
        (t11, LevelPose(1.0, 2.0, 1.23, INTO - np.radians(1.0))),
        (t11, LevelPose(2.4, 2.0, 2.4, INTO + np.radians(0.7))),
    )


@pytest.fixture(scope="session")
def rack_shot(photograph: Photograph, rack_pallets: Pallets, whole_view: CameraModel) -> Shot:
    """Return a 360-degree shot from a camera 1.3 m above the floor."""
    return photograph(rack_pallets, whole_view, (0.1, 0.0, 1.3, 0.5, -0.4, 0.6))


@pytest.fixture(scope="session")
def blank_shot(floor_shot: Shot) -> Shot:
    """Return a shot without anything to see, from where `floor_shot` was taken."""
    return replace(floor_shot, image=np.full_like(floor_shot.image, 128))


@pytest.fixture(scope="session")
def draw_face() -> Callable[..., PlaneView]:
    """Return a function that draws how a sharp flat face appears on a vertical plane, by casting rays.

    The plane stands before a camera at ``plane_from_camera``; the face's lower middle is ``place`` (right,
    up) on its own plane, which is ``scale`` times as far from the camera and turned by ``yaw``.
    """

    def drawn(
        model: PalletModel,
        grid: PlaneGrid,
        plane_from_camera: FloatArray,
        place: tuple[float, float] = (0.0, 0.0),
        scale: float = 1.0,
        yaw: float = 0.0,
        levels: tuple[float, float, float] = (90.0, 180.0, 30.0),
    ) -> PlaneView:
        step = (np.arange(4) - 1.5) / 4
        columns, rows = np.meshgrid(
            (np.arange(grid.columns)[:, None] + step).ravel(), (np.arange(grid.rows)[:, None] + step).ravel()
        )
        points = grid.points(np.stack([columns, rows], -1))
        right, up, distance = plane_from_camera
        rays = np.concatenate([points - [right, up], np.full((*points.shape[:2], 1), -distance)], -1)
        # the face's plane: through (place, depth behind the viewed plane), its right turned away by the yaw
        origin = np.array([place[0], place[1], -(scale - 1) * distance])
        along = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
        normal = np.array([np.sin(yaw), 0.0, np.cos(yaw)])
        camera = np.array([right, up, distance])
        reached = camera + rays * (((origin - camera) @ normal) / (rays @ normal))[..., None]
        across, above = (reached - origin) @ along, reached[..., 1] - origin[1]
        image = np.full(across.shape, levels[0])
        image[(np.abs(across) <= model.width / 2) & (above >= 0) & (above <= model.height)] = levels[1]
        for opening in model.openings:
            inside = np.abs(across - opening.center) <= opening.width / 2
            image[inside & (above >= opening.bottom) & (above <= opening.top)] = levels[2]
        small = image.reshape(grid.rows, 4, grid.columns, 4).mean(axis=(1, 3))
        valid = np.ones(small.shape, dtype=bool)
        return PlaneView(np.round(small).astype(np.uint8), valid, grid, RigidTransform.identity())

    return drawn
