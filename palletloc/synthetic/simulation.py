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
from palletloc.synthetic.rays import CameraRays, camera_rays
from palletloc.synthetic.rendering import LitScene, RenderedImage, lit, render
from palletloc.synthetic.rig import Sensor, camera_of, disturbed, draw_mounting, expose
from palletloc.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Approach:
    """A way that winds a little around a straight line; the heading follows the way."""

    start: LevelPose = LevelPose(-0.8, 0.0, 0.0, 0.0)
    """World pose that the straight line begins at."""
    length: float = 3.2
    """Along the line, in metres."""
    speed: float = 0.5
    """Along the line, in metres per second."""
    winding: float = 0.02
    """Largest distance from the line, in metres."""
    wavelength: float = 3.0
    """Of the windings, in metres."""
    phase: float = 0.0
    """Of the windings at the start, in radians."""

    @property
    def duration(self) -> float:
        """How long it takes, in seconds."""
        return self.length / self.speed

    def poses(self, times: FloatArray) -> FloatArray:
        """Return ``world_from_forklift`` at times, (n,) in seconds from the start: (n, 3) of x, y and yaw."""
        wave = 2 * np.pi / self.wavelength
        along = self.speed * np.asarray(times)
        across = self.winding * np.sin(wave * along + self.phase)
        turn = np.arctan(self.winding * wave * np.cos(wave * along + self.phase))
        cos, sin = np.cos(self.start.yaw), np.sin(self.start.yaw)
        return np.stack(
            [
                self.start.x + cos * along - sin * across,
                self.start.y + sin * along + cos * across,
                self.start.yaw + turn,
            ],
            -1,
        )


@dataclass(frozen=True, slots=True)
class SimulatedOdometryNoise:
    """Errors of wheel odometry and gyroscope; all zero for perfect ones."""

    scale_sigma: float = 0.006
    """Standard deviation of the relative error of distances, constant over an approach."""
    bias_sigma: float = 0.004
    """Standard deviation of the gyroscope's bias, constant over an approach, in radians per second."""
    speed_sigma: float = 0.03
    """Standard deviation of each sample's speed, in metres per second."""
    yaw_rate_sigma: float = 0.01
    """Standard deviation of each sample's yaw rate, in radians per second."""


def measure_odometry(
    approach: Approach, noise: SimulatedOdometryNoise, rng: np.random.Generator, rate: float = 50.0
) -> Trajectory:
    """Return what odometry measures of an approach.

    Each sample's motion is measured with its errors and added up, so that the pose drifts.

    Parameters
    ----------
    approach : Approach
        The true way.
    noise : SimulatedOdometryNoise
        Its errors.
    rng : numpy.random.Generator
        Draws them.
    rate : float
        Samples per second.

    Returns
    -------
    Trajectory
        ``odom_from_forklift`` with speed and yaw rate, from the pose at the start, which is zero, to the end.
    """
    count = int(np.ceil(approach.duration * rate - 1e-9)) + 1
    times = np.arange(count) / rate
    step = 1 / rate
    motion = _motion(approach.poses(times))
    scale = 1 + noise.scale_sigma * rng.standard_normal()
    bias = noise.bias_sigma * rng.standard_normal()
    motion[:, :2] *= scale
    motion[:, 0] += noise.speed_sigma * step * rng.standard_normal(count - 1)
    motion[:, 2] += (bias + noise.yaw_rate_sigma * rng.standard_normal(count - 1)) * step
    yaw = np.concatenate([[0.0], np.cumsum(motion[:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * motion[:, 0] - sin * motion[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(sin * motion[:, 0] + cos * motion[:, 1])])
    rates = np.concatenate([motion[:1], motion]) / step
    return Trajectory(times=times, x=x, y=y, yaw=yaw, speed=rates[:, 0], yaw_rate=rates[:, 2])


def _motion(poses: FloatArray) -> FloatArray:
    """Return each pose in the frame of the one before, (n - 1, 3)."""
    delta = np.diff(poses, axis=0)
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    return np.stack([cos * delta[:, 0] + sin * delta[:, 1], cos * delta[:, 1] - sin * delta[:, 0], delta[:, 2]], -1)


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
    odometry: SimulatedOdometryNoise = SimulatedOdometryNoise()
    """Errors of the odometry."""
    sensor: Sensor = Sensor()
    """Blur, noise and exposure."""
    plane_offset: float = 0.03
    """Largest error of the nominal shelf plane's distance, in metres."""
    plane_turn: float = 0.014
    """Largest error of the nominal shelf plane's heading, in radians."""
    tell_levels: bool = True
    """Whether the recording states the heights that loads stand on."""
    level_sigma: float = 0.0
    """Errors of the heights that it states (standard deviation), in metres; all loads of a level share one."""
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
    """Its mounting as the recording states it, with its errors."""
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

    def picture(self, index: int) -> RenderedImage:
        """Return what the camera sees at one shot, before its sensor."""
        x, y, yaw = self.approach.poses(self.times[index : index + 1])[0].tolist()
        world_from_forklift = LevelPose(x, y, 0.0, yaw).transform()
        return render(self.scene, self.rays, world_from_forklift * self.forklift_from_camera)

    def image(self, index: int) -> Image:
        """Return one shot; in whatever order they are asked for, they are the same."""
        return self.exposed(index, self.picture(index))

    def exposed(self, index: int, picture: RenderedImage) -> Image:
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
    """Return the plane of the fronts as the recording states it: in odom, and off."""
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
