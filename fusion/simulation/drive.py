"""One simulated drive: what the sensors give, and the truth."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion.simulation.cache import Frame, Frames, Progress, cached_frames
from fusion.simulation.camera import PanoramaCamera
from fusion.simulation.effects import FrameEffects, encode_jpeg
from fusion.simulation.experiment import Experiment
from fusion.simulation.experiments import find_experiment
from fusion.simulation.imu import ImuReading, read_imu
from fusion.simulation.rendering import Renderer, camera_poses
from fusion.simulation.robot import OdometryReading, read_tracks
from fusion.simulation.worlds import TUNED_WORLDS, choose_world

Floats = npt.NDArray[np.float64]

START_NS = 1_366_934_400_000_000_000  # stamp of the start of every drive
ODOMETRY_DELAY_NS = 3_000_000  # the sensors' clocks tick between each other
TRUTH_HZ = 200.0
CAMERA = PanoramaCamera()


@dataclass(frozen=True, slots=True)
class Truth:
    """The robot's true motion in the frame of its starting pose (REP-105 ``odom``); arrays of one shape.

    Attributes
    ----------
    t_ns : ndarray of int64
        Stamps, ns, increasing.
    x, y : ndarray
        m.
    yaw : ndarray
        Unwrapped, rad, 0 at the start.
    yaw_rate : ndarray
        rad/s.
    speed : ndarray
        Along +x, m/s.
    roll, pitch : ndarray
        rad.
    """

    t_ns: npt.NDArray[np.int64]
    x: Floats
    y: Floats
    yaw: Floats
    yaw_rate: Floats
    speed: Floats
    roll: Floats
    pitch: Floats

    def yaw_at(self, t_ns: npt.ArrayLike) -> Floats:
        """Yaw at any stamps, rad, unwrapped; exact at those of `t_ns`, within 2e-5 rad between them."""
        return np.asarray(np.interp(np.asarray(t_ns, np.int64) - START_NS, self.t_ns - START_NS, self.yaw), np.float64)


@dataclass(eq=False)
class Drive:
    """What the sensors gave on one drive, and the truth. Frames are rendered when they are first asked for.

    Attributes
    ----------
    imu : sequence of ImuReading
        100 Hz.
    odometry : sequence of OdometryReading
        40 Hz.
    truth : Truth
        At 200 Hz, and whenever a frame was exposed.
    frame_t_ns : ndarray of int64
        Stamps of the frames as the camera's driver gives them, ns.
    frame_truth : Truth
        When the frames were exposed.
    """

    imu: Sequence[ImuReading]
    odometry: Sequence[OdometryReading]
    truth: Truth
    frame_t_ns: npt.NDArray[np.int64]
    frame_truth: Truth
    _effects: FrameEffects
    _jpeg_quality: int
    _load: Callable[[Progress | None], Frames]
    _clean: Frames | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return int(self.frame_t_ns.size)

    def prepare(self, progress: Progress | None = None) -> Frames:
        """Render the clean frames (no body, noise or change of exposure), or find them in the cache.

        Parameters
        ----------
        progress : callable or None
            Called with (frames done, count) while rendering; not at all when they are in the cache.
        """
        if self._clean is None:
            self._clean = self._load(progress)
        return self._clean

    def frame(self, index: int) -> Frame:
        """Frame number `index` as the camera gives it, uint8 (height, width)."""
        return self._effects.apply(index, self.prepare()[index])

    def frames(self) -> Iterator[tuple[int, Frame]]:
        """Stamp, ns, and image, uint8 (height, width), of each frame."""
        for index, stamp in enumerate(self.frame_t_ns.tolist()):
            yield stamp, self.frame(index)

    def jpeg_frames(self) -> Iterator[tuple[int, bytes]]:
        """Stamp, ns, and JPEG file of each frame."""
        for stamp, image in self.frames():
            yield stamp, encode_jpeg(image, self._jpeg_quality)


def simulate(
    name: str,
    seed: int = 0,
    *,
    worlds: str = TUNED_WORLDS,
    cache: Path | None = None,
    workers: int = 2,
    camera: PanoramaCamera = CAMERA,
    keep: bool = True,
) -> Drive:
    """Drive one of the `EXPERIMENTS`.

    Parameters
    ----------
    name : str
        Which.
    seed : int
        Chooses the sensors' errors, how images are stamped, the ground's grip, the exposure, and the world: a scene of
        its own in the held-out places, every few another of the tuned ones. Same name, seed and worlds, same bytes.
    worlds : str
        See `choose_world`.
    cache : Path or None
        Directory for rendered frames; None: see `cache_directory`.
    workers : int
        Threads that render.
    camera : PanoramaCamera
        Size of the panorama.
    keep : bool
        Whether frames that have to be rendered are put into the cache; else each is rendered when it is asked for.

    Raises
    ------
    SimulationError
        There is no experiment of that name, or no such worlds.
    """
    experiment = find_experiment(name)
    world = choose_world(experiment, seed, worlds)
    times = experiment.frame_times()
    motion = experiment.trajectory.in_place.at(times)
    streams = [np.random.default_rng([seed, zlib.crc32(name.encode()), stream]) for stream in range(4)]
    effects = FrameEffects(experiment.effects, times, motion.yaw_rate, int(streams[2].integers(2**31)))
    renderer = Renderer(camera, camera_poses(motion, experiment.mount), times.tolist(), experiment.rolled)

    def load(progress: Progress | None) -> Frames:
        def start() -> Callable[[int], Frame]:
            return renderer.start(world.build)

        label = f"{name}-{world.name}-{seed}" if world.held_out else f"{name}-{world.name}"
        key = world.key + renderer.key()
        return cached_frames(label, key, times.size, start, cache, workers, progress, keep=keep)

    stamps = times if experiment.stamps is None else np.rint(experiment.stamps.stamp(times, streams[3]) * 1e9) / 1e9
    fine = np.rint(np.arange(0.0, experiment.trajectory.duration, 1.0 / TRUTH_HZ) * 1e9) / 1e9
    return Drive(
        read_imu(experiment.trajectory, experiment.imu, streams[0], START_NS),
        read_tracks(experiment.trajectory, experiment.surface, streams[1], START_NS + ODOMETRY_DELAY_NS),
        true_motion(experiment, np.union1d(fine, times)),
        START_NS + np.round(stamps * 1e9).astype(np.int64),
        true_motion(experiment, times),
        effects,
        experiment.effects.jpeg_quality,
        load,
    )


def true_motion(experiment: Experiment, t: Floats) -> Truth:
    """The truth at times `t`, s since the start."""
    motion, start = experiment.trajectory.at(t), experiment.trajectory.at(np.zeros(1))
    x0, y0, heading = float(start.x[0]), float(start.y[0]), float(start.yaw[0])
    dx, dy = motion.x - x0, motion.y - y0
    return Truth(
        t_ns=START_NS + np.round(t * 1e9).astype(np.int64),
        x=dx * np.cos(heading) + dy * np.sin(heading),
        y=dy * np.cos(heading) - dx * np.sin(heading),
        yaw=motion.yaw - heading,
        yaw_rate=motion.yaw_rate,
        speed=motion.speed,
        roll=motion.roll,
        pitch=motion.pitch,
    )
