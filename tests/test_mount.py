"""An IMU mounted any way round, on level ground and on a slope: the yaw once the robot has turned, images included."""

import math

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compass import CompassConfig
from fusion import YawPipeline
from fusion.imu.levelling import ImuConfig, ImuLevel

SIDE = 512  # columns of a panorama
SECONDS, HZ = 4.0, 50
FLOOR = math.radians(0.05)  # below it nobody needs a sigma


def scene(seed):
    """A texture round the whole sphere, as an image of three times its width, for interpolation across the seam."""
    texture = np.random.default_rng(seed).integers(0, 255, (SIDE // 2, SIDE), np.uint8)
    return cv2.GaussianBlur(np.tile(texture, 3), (0, 0), 2.0)


def seen(image, attitude):
    """The panorama of a camera that has turned and tilted far from everything."""
    azimuth = math.pi - (np.arange(SIDE) + 0.5) * math.tau / SIDE
    elevation = 0.5 * math.pi - (np.arange(SIDE // 2)[:, None] + 0.5) * math.tau / SIDE
    level = np.cos(elevation)
    rays = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), -1)
    x, y, z = np.moveaxis(rays @ attitude.as_matrix().T, -1, 0)
    column = SIDE + (math.pi - np.arctan2(y, x)) * SIDE / math.tau - 0.5
    row = (0.5 * math.pi - np.arcsin(np.clip(z, -1.0, 1.0))) * SIDE / math.tau - 0.5
    return cv2.remap(image, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)


@pytest.mark.parametrize(
    ("mount_deg", "slope_deg"),
    [((0, 0, 0), 0), ((0, 0, 20), 0), ((0, -12, 15), 0), ((40, -10, 15), 0), ((0, 0, 0), 20)],
    ids=["aligned", "rolled", "rolled and pitched", "any way round", "aligned, on a slope"],
)
def test_yaw_of_a_keyframe_from_before_the_mount_was_known_is_right(mount_deg, slope_deg):
    mount = Rotation.from_euler("ZYX", mount_deg, degrees=True)
    slope = Rotation.from_euler("x", slope_deg, degrees=True)
    level, pipeline = ImuLevel(ImuConfig()), YawPipeline(CompassConfig(columns=SIDE))
    rng, picture = np.random.default_rng(0), scene(0)

    def heading(t_ns):
        nose = (slope * Rotation.from_euler("z", 0.6 * max(t_ns * 1e-9 - 1.0, 0.0))).apply([1.0, 0.0, 0.0])
        return math.atan2(nose[1], nose[0])

    for k in range(int(SECONDS * HZ)):
        t_ns = k * 10**9 // HZ
        robot = slope * Rotation.from_euler("z", 0.6 * max(t_ns * 1e-9 - 1.0, 0.0))
        rate = np.array([0.0, 0.0, 0.6 * (t_ns > 10**9)])
        force = (robot * mount).inv().apply([0.0, 0.0, 9.81])
        pipeline.add(level.sample(t_ns, mount.inv().apply(rate) + 0.002 * rng.normal(size=3), force))
        if k % 10 == 0:
            noise = rng.normal(0.0, 2.0, (SIDE // 2, SIDE))
            pipeline.add_image(t_ns, np.clip(seen(picture, robot) + noise, 0, 255).astype(np.uint8))
            image_ns = t_ns
    compass, estimate = pipeline.compass, pipeline.estimate()
    for yaw, variance, at_ns in (
        (compass.yaw, compass.yaw_variance, image_ns),
        (estimate.yaw, estimate.yaw_variance, estimate.t_ns),
    ):
        assert abs(yaw - heading(at_ns)) < 3.0 * math.sqrt(variance + FLOOR**2)
        assert math.sqrt(variance) < math.radians(1.0)
    assert not estimate.warnings
