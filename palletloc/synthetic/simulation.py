"""A synthetic recording in memory: its truth, its odometry, and its shots when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.choices import CameraKind
from palletloc.geometry import FloatArray, Image, LevelPose, wrap_angle
from palletloc.shelf import ShelfPlane
from palletloc.synthetic.aisle import Aisle, AisleSpec, draw_aisle
from palletloc.synthetic.approach import Approach, OdometryNoise, measure_odometry
from palletloc.synthetic.rays import CameraRays, camera_rays
from palletloc.synthetic.rendering import Picture, render
from palletloc.synthetic.rig import camera_of, disturbed, draw_mounting
from palletloc.synthetic.sensor import Sensor, expose
from palletloc.synthetic.shading import LitScene, lit
from palletloc.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class SimulationSpec:
    """What to simulate."""

    aisle: AisleSpec
    """The scene."""
    camera: CameraKind = CameraKind.EQUIRECTANGULAR
    """The kind of camera."""
    width: int = 1920
    """Of its image, in pixels."""
    shots: int = 12
    """How many, evenly spaced from start to end of the approach."""
    approach: Approach | None = None
    """The way; None to draw one."""
    odometry: OdometryNoise = OdometryNoise()
    """Errors of the odometry."""
    sensor: Sensor = Sensor()
    """Blur, noise and exposure."""
    plane_offset: float = 0.03
    """Largest error of the nominal shelf plane's distance, in metres."""
    plane_turn: float = 0.014
    """Largest error of the nominal shelf plane's heading, in radians."""
    tell_levels: bool = True
    """Whether the recording says the heights that loads stand on."""
    level_sigma: float = 0.0
    """Errors of the heights that it says (standard deviation), in metres; all loads of a level share one."""
    mounting: RigidTransform | None = None
    """True ``forklift_from_camera``; None to draw one."""
    mounting_translation_sigma: float = 0.0
    """Errors of the recorded mounting along each axis (standard deviation), in metres."""
    mounting_rotation_sigma: float = 0.0
    """Errors of its rotation about each of the forklift's axes (standard deviation), in radians."""


@dataclass(frozen=True)
class Simulation:
    """An approach to pallets, as simulated."""

    spec: SimulationSpec
    """What was asked for."""
    seed: int
    """Of all randomness: the same spec and seed give the same simulation."""
    aisle: Aisle
    """The scene and the true pallets."""
    approach: Approach
    """The true way."""
    camera: CameraModel
    """The camera."""
    forklift_from_camera: RigidTransform
    """Its true mounting."""
    recorded_mounting: RigidTransform
    """Its mounting as the recording says it, with its errors."""
    shelf: ShelfPlane
    """The nominal front plane of the shelf, in odom, with its errors."""
    odometry: Trajectory
    """``odom_from_forklift`` as measured."""

    @cached_property
    def times(self) -> FloatArray:
        """(shots,) when the shots are exposed, in seconds."""
        times = np.linspace(0.0, self.approach.duration, self.spec.shots)
        return np.round(times, 6)  # as files keep them

    @cached_property
    def truth(self) -> Trajectory:
        """``world_from_forklift`` at the shots."""
        x, y, yaw = self.approach.poses(self.times).T
        return Trajectory(times=self.times, x=x, y=y, yaw=yaw, z=np.zeros(len(x)))

    @cached_property
    def scene(self) -> LitScene:
        """The scene with its light."""
        return lit(self.aisle.scene)

    @cached_property
    def rays(self) -> CameraRays:
        """The camera's rays."""
        return camera_rays(self.camera)

    def picture(self, index: int) -> Picture:
        """Return what the camera sees at one shot, before its sensor."""
        x, y, yaw = self.approach.poses(self.times[index : index + 1])[0].tolist()
        world_from_forklift = LevelPose(x, y, 0.0, yaw).transform()
        return render(self.scene, self.rays, world_from_forklift * self.forklift_from_camera)

    def image(self, index: int) -> Image:
        """Return one shot; in whatever order they are asked for, they are the same."""
        return self.exposed(index, self.picture(index))

    def exposed(self, index: int, picture: Picture) -> Image:
        """Return one shot, from its `picture`."""
        rng = np.random.default_rng([self.seed, index])
        return expose(picture.radiance, self.spec.sensor, self.camera.period_px is not None, rng)

    def images(self) -> Iterator[Image]:
        """Return the shots one by one."""
        return (self.image(index) for index in range(self.spec.shots))


def simulate(spec: SimulationSpec, seed: int) -> Simulation:
    """Draw a simulation.

    Parameters
    ----------
    spec : SimulationSpec
        What to simulate.
    seed : int
        Not negative. Scene, way, odometry and mounting are drawn from it one by one, so that a change of the
        noise leaves the scene as it is.

    Returns
    -------
    Simulation
        Its pictures are rendered when they are asked for.

    Raises
    ------
    ValueError
        If there are no shots, no pallet models or no levels.
    """
    if spec.shots < 1:
        raise ValueError(f"a simulation needs at least one shot, got {spec.shots}")
    for_aisle, for_way, for_odometry, for_rig, for_plane = np.random.default_rng(seed).spawn(5)
    aisle = draw_aisle(spec.aisle, for_aisle)
    approach = spec.approach or _draw_approach(for_way)
    mounting = spec.mounting
    if mounting is None:
        mounting = draw_mounting(spec.camera, spec.aisle.side, for_rig)
    recorded = disturbed(mounting, spec.mounting_translation_sigma, spec.mounting_rotation_sigma, for_rig)
    return Simulation(
        spec=spec,
        seed=seed,
        aisle=aisle,
        approach=approach,
        camera=camera_of(spec.camera, spec.width),
        forklift_from_camera=mounting,
        recorded_mounting=recorded,
        shelf=_nominal_shelf(spec, aisle, approach, for_plane),
        odometry=measure_odometry(approach, spec.odometry, for_odometry),
    )


def _draw_approach(rng: np.random.Generator) -> Approach:
    return Approach(
        start=LevelPose(
            float(rng.uniform(-1.5, -0.5)),
            float(rng.uniform(-0.15, 0.15)),
            0.0,
            float(np.radians(rng.uniform(-1.5, 1.5))),
        ),
        length=float(rng.uniform(2.5, 4.0)),
        speed=float(rng.uniform(0.3, 0.8)),
        winding=float(rng.uniform(0.0, 0.03)),
        wavelength=float(rng.uniform(2.5, 5.0)),
        phase=float(rng.uniform(-np.pi, np.pi)),
    )


def _nominal_shelf(spec: SimulationSpec, aisle: Aisle, approach: Approach, rng: np.random.Generator) -> ShelfPlane:
    """Return the plane of the fronts as the recording says it: in odom, and off."""
    offset, turn = rng.uniform(-1, 1, 2) * (spec.plane_offset, spec.plane_turn)
    levels = np.sort(spec.aisle.levels) + spec.level_sigma * rng.standard_normal(len(spec.aisle.levels))
    middle = aisle.frame.world(float(offset), approach.start.x + approach.length, 0.0)
    x, y, yaw = approach.poses(np.zeros(1))[0].tolist()
    in_world = ShelfPlane(
        middle.x,
        middle.y,
        wrap_angle(middle.yaw + np.pi + float(turn)),
        tuple(levels.tolist()) if spec.tell_levels else (),
    )
    return in_world.seen_from(LevelPose(x, y, 0.0, yaw))
