"""A ray-cast world, a tracked robot and its sensors, with known truth.

`simulate` drives one of the `EXPERIMENTS` and gives a `Drive`: panoramas, inertial unit, track odometry, truth.
Rendering is the slow part; the clean frames of an experiment are cached, and what a seed varies is applied to them.
An experiment is driven in its own place (`places`, `yards`), in which the estimator was developed, or in one of the
`held_out` places, on which no constant was chosen; `worlds` chooses.
"""

from fusion.simulation.camera import PanoramaCamera
from fusion.simulation.drive import Drive, Truth, simulate
from fusion.simulation.effects import Effects
from fusion.simulation.experiment import Experiment, SimulationError
from fusion.simulation.experiments import EXPERIMENTS
from fusion.simulation.imu import ImuModel, ImuReading
from fusion.simulation.painter import CameraPose
from fusion.simulation.robot import OdometryReading, Surface

__all__ = [
    "EXPERIMENTS",
    "CameraPose",
    "Drive",
    "Effects",
    "Experiment",
    "ImuModel",
    "ImuReading",
    "OdometryReading",
    "PanoramaCamera",
    "SimulationError",
    "Surface",
    "Truth",
    "simulate",
]
