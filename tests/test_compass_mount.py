"""A camera that is not mounted level on the robot: the mount is learnt from turns, and the yaw stays true."""

import json
import math

import cv2
import numpy as np
import pytest
from panoramas import FRAME_NS, START_NS, as_bytes, scene
from tiny_bags import TinyBag, TinyDrive, fill

from compass import CompassConfig, VisualCompass
from compass.mount import SIGMA, CameraMount
from compass.tilt import STEEPEST_COSINE, camera_rotation
from fusion.offline.cli import main

pytestmark = pytest.mark.usefixtures("without_plot")

WIDTH, HEIGHT = 512, 256
SCENE = scene(3, WIDTH, HEIGHT)
STEP = math.radians(4.0)
LEVEL = (0.0, 0.0, 1.0)


def rotation(x, y, z):
    return cv2.Rodrigues(np.array([x, y, z], np.float64))[0]


def seen_by(attitude):
    """(y, x) of the panorama at each pixel of a camera of this attitude, a matrix from its frame to the world's."""
    azimuth = math.pi - (np.arange(WIDTH) + 0.5) * math.tau / WIDTH
    elevation = (math.pi / 2 - (np.arange(HEIGHT) + 0.5) * math.pi / HEIGHT)[:, None]
    ray = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0.0 * azimuth]
    x, y, z = np.tensordot(attitude, np.stack(ray), 1)
    column = (math.pi - np.arctan2(y, x)) * WIDTH / math.tau - 0.5
    row = (math.pi / 2 - np.arcsin(np.clip(z, -1.0, 1.0))) * HEIGHT / math.pi - 0.5
    wide = cv2.copyMakeBorder(SCENE.astype(np.float32), 0, 0, 2, 2, cv2.BORDER_WRAP)
    at = (column % WIDTH + 2.0).astype(np.float32), row.astype(np.float32)
    return cv2.remap(wide, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def drive(compass, mount, yaws, ground=None):
    """The compass's increments, and the accumulated error, rad, of a robot on `ground` (a matrix) at these yaws."""
    given, errors = [], []
    for index, yaw in enumerate(yaws):
        robot = rotation(0.0, 0.0, yaw) if ground is None else ground @ rotation(0.0, 0.0, yaw)
        given.append(compass.update(START_NS + index * FRAME_NS, as_bytes(seen_by(robot @ mount), 1.0, index)))
        errors.append(compass.yaw - yaw)
    return given, np.array(errors)


# a camera that is tilted by m sees turns too small by 1 - cos(m), until 33 deg of turning have taught it
@pytest.mark.parametrize("tilt", [(0.0, 10.0), (-6.0, 3.0), (10.0, -12.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_yaw_of_a_tilted_camera_is_the_robots(tilt, sign):
    compass = VisualCompass(CompassConfig(roi_top=0.3, roi_bottom=0.7), lambda t_ns: (0.0, 0.0, 1.0))
    given, errors = drive(compass, rotation(*np.radians(tilt), 0.0), sign * STEP * np.arange(181))
    assert np.degrees(np.abs(errors)).max() < 33.0 * (1.0 - math.cos(math.radians(math.hypot(*tilt))))
    assert all(np.hypot(*one.tilt) < math.radians(0.5) for one in given[60:])
    # it says what it has learnt, by REP 103: that the camera leans to the right and looks down
    learnt = np.degrees([compass.mount.roll, compass.mount.pitch])
    assert learnt == pytest.approx(tilt, abs=max(3.0 * math.degrees(compass.mount.sigma), 0.5))
    assert compass.mount.sigma < math.radians(0.5)


def test_level_camera_on_a_tilted_robot_is_level():
    ground = rotation(math.radians(8.0), 0.0, 0.0)

    def up(t_ns):
        yaw = STEP * (t_ns - START_NS) / FRAME_NS
        return tuple((ground @ rotation(0.0, 0.0, yaw)).T @ (0.0, 0.0, 1.0))

    compass = VisualCompass(CompassConfig(roi_top=0.3, roi_bottom=0.7), up)
    given, _ = drive(compass, np.eye(3), STEP * np.arange(91), ground)
    assert all(np.hypot(*one.tilt) < math.radians(0.3) for one in given[1:])


def test_mount_without_an_imu_stays_unknown():
    compass = VisualCompass(CompassConfig(roi_top=0.3, roi_bottom=0.7))
    drive(compass, rotation(0.0, math.radians(10.0), 0.0), STEP * np.arange(31))
    assert compass.mount == CameraMount()


class Askew(TinyDrive):
    """A robot that turns, level, whose camera looks down by 10 deg."""

    def panorama(self, t, seed=5):
        return as_bytes(seen_by(rotation(0.0, 0.0, self.yaw(t)) @ rotation(0.0, math.radians(10.0), 0.0)), 1.0, seed)


def test_fuse_tells_how_the_camera_is_mounted(tmp_path, capsys):
    with TinyBag(tmp_path / "bag") as bag:
        fill(bag, Askew(seconds=10.0))
    assert main(["fuse", str(tmp_path / "bag"), "--out", str(tmp_path / "out")]) == 0
    assert "the camera is not mounted level on the robot: roll " in capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    angles = [summary["camera_roll_deg"], summary["camera_pitch_deg"]]
    assert angles == pytest.approx([0.0, 10.0], abs=max(3.0 * summary["camera_tilt_sigma_deg"], 0.5))
    assert summary["camera_tilt_sigma_deg"] < 0.5


def test_diagnostics_tell_how_the_camera_is_mounted():
    diagnostics = pytest.importorskip("nodes.diagnostics", reason="needs ROS", exc_type=ImportError)
    compass = VisualCompass()
    compass.mount = CameraMount(0.1, -0.05, variance=math.radians(0.3) ** 2, noise=math.radians(0.4) ** 2)
    figures = diagnostics.compass_figures(compass, 1.0)
    told = [figures[f"camera {what} [deg]"] for what in ("roll on the robot", "pitch on the robot", "tilt sigma")]
    assert told == ["-2.88", "-5.74", "0.50"]


def split(seen):
    """Turn and tilt of a rotation."""
    turn = math.atan2(seen[1, 0] - seen[0, 1], seen[0, 0] + seen[1, 1])
    x, y, _ = cv2.Rodrigues(seen @ rotation(0.0, 0.0, -turn))[0].ravel()
    return turn, (-x, -y)


def test_turn_and_tilt_survive_the_way_to_the_robot_and_back():
    mount = CameraMount(0.2, -0.1, variance=0.0)
    turn, tilt = mount.on_robot(0.7, (0.05, -0.02))
    matrix = mount._rotation()
    assert matrix @ camera_rotation(turn, tilt) @ matrix.T == pytest.approx(
        camera_rotation(0.7, (0.05, -0.02)), abs=1e-12
    )
    assert CameraMount().on_robot(0.7, (0.05, -0.02))[0] == pytest.approx(0.7)
    assert mount.on_robot(mount.on_camera(0.4), split(matrix @ rotation(0, 0, 0.4) @ matrix.T)[1])[0] == pytest.approx(
        0.4
    )


def learnt_from(mount, degrees, angles, noise=0.0):
    """The mount with what a camera tilted by `degrees` sees of a level robot that turns by `angles`, rad."""
    rng = np.random.default_rng(4)
    matrix = rotation(0.0, math.radians(degrees), 0.0)
    for angle in angles:
        turn, tilt = split(matrix @ rotation(0.0, 0.0, angle) @ matrix.T)
        mount = mount.after(turn, tuple(tilt + noise * rng.normal(size=2)), LEVEL, LEVEL)
    return mount


def test_mount_is_learnt_and_learnt_anew():
    mount = CameraMount()
    for degrees in (10.0, -5.0):
        mount = learnt_from(mount, degrees, [0.1, -0.2, 0.4, 0.1] * 50, 0.002)
        assert (mount.x, mount.y) == pytest.approx((math.sin(math.radians(degrees)), 0.0), abs=5e-3)


def test_mount_is_not_learnt_from_bumps_nor_at_rest():
    mount = learnt_from(CameraMount(), 0.0, [0.02, -0.05, 0.1] * 100, math.radians(2.0))
    assert mount.seen(LEVEL) == pytest.approx(LEVEL, abs=math.radians(0.5))
    assert learnt_from(CameraMount(), 10.0, [0.0] * 1000).variance == pytest.approx(SIGMA**2)


@pytest.mark.parametrize("degrees", [60.0, -80.0])
def test_mount_stays_one_of_a_camera_that_looks_at_the_horizon(degrees):
    mount = learnt_from(CameraMount(), degrees, [0.3, -0.5] * 50)
    assert math.sqrt(1.0 - mount.x**2 - mount.y**2) >= STEEPEST_COSINE - 1e-12
