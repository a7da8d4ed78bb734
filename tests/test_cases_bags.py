"""Bags as people report them, through ``visual-compass fuse``: the yaw is within sigma, and the fault is named."""

import json
import math
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
import pytest
from reported_bags import TURNED_DEG, Imu, Message, Picture, Tracks, changed, messages, write, yaw
from scipy.spatial.transform import Rotation
from tiny_bags import START_NS

from fusion.offline.cli import main

pytestmark = pytest.mark.usefixtures("without_plot")

NO_IMAGE, NO_GYRO, NO_ODOMETRY = ((f"--{role}-topic", "none") for role in ("image", "gyro", "odometry"))
BOOT_NS = 2128 * 10**9  # a clock that began at power-up
FLOOR_DEG = 0.1  # of sigma: JPEG of 256 columns, 1.4 deg each


@dataclass(frozen=True)
class Situation:
    """One thing that is wrong.

    `sigma` is what the final sigma may be, deg; where `codes` are given one of them must be among the warnings, and
    where `refuse` is given the command says one line that matches it and exits with 1, or does all of the rest.
    """

    change: Callable[[Message], object] = lambda message: message
    arguments: tuple[str, ...] = ()
    sigma: float = math.inf
    codes: tuple[str, ...] = ()
    refuse: str = ""
    rates: dict[str, float] = field(default_factory=dict)


def of(kind: type, change: Callable) -> Callable[[Message], object]:
    """Change one kind of message."""
    return lambda message: change(message) if isinstance(message, kind) else message


def gyro(rate: Callable[[float, float], float]) -> Callable[[Message], object]:
    """Another turn rate, of the right one and the time."""
    return of(Imu, lambda m: replace(m, rate=(0.0, 0.0, rate(m.rate[2], m.t))))


def spikes(share: float, size: float) -> Callable[[Message], object]:
    """Single samples of the gyro that are nonsense."""
    hit = np.random.default_rng(0).random(1000) < share
    return gyro(lambda w, t: size if hit[round(50.0 * t)] else w)


def imu_clock(stamp: Callable[[float], float], kind: type = Imu) -> Callable[[Message], object]:
    """Other stamps, s since the bag began."""
    return of(kind, lambda m: replace(m, t_ns=START_NS + round(stamp(m.t) * 1e9)))


def clocks_ahead(seconds: float) -> Callable[[Message], object]:
    """The host sets its clock while the robot turns."""
    return lambda m: replace(m, t_ns=m.t_ns + round(seconds * 1e9)) if m.t >= 4.0 else m


def pixels(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Message], object]:
    return of(Picture, lambda m: replace(m, pixels=change(m.pixels)))


def right_half(image: np.ndarray) -> np.ndarray:
    return cv2.resize(image[:, 128:], (256, 128))


def lettered(image: np.ndarray) -> np.ndarray:
    """With what a driver writes into it, larger and brighter than all that turns."""
    return cv2.putText(image.copy(), "REC 12:00:00", (5, 70), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 3)


def without_gravity(m: Imu) -> Imu:
    half = 0.5 * float(yaw(m.t))
    force = m.force[0], m.force[1], m.force[2] - 9.81
    return replace(m, force=force, orientation=(0, 0, math.sin(half), math.cos(half)), orientation_known=True)


def in_turn(m: Imu) -> Imu:
    odd = round(m.t * 50.0) % 2
    return replace(m, rate=(0.0, 0.0, 0.0)) if odd else replace(m, force=(0.0, 0.0, 0.0))


def in_two(m: Imu) -> list[Imu]:
    return [replace(m, rate=(0.0, 0.0, 0.0)), replace(m, force=(0.0, 0.0, 0.0))]


def pitched(m: Imu) -> Imu:
    mount = Rotation.from_euler("y", 15, degrees=True).inv()
    rate, force = (tuple(map(float, mount.apply(v))) for v in (m.rate, m.force))
    return replace(m, rate=rate, force=force, orientation=(0, 0, 0, 1), orientation_known=True)


def pitched_without_gravity(m: Imu) -> Imu:
    """Nothing says how it lies, and its z axis sees less than the turn."""
    m = pitched(m)
    return replace(m, force=(0.01, -0.02, 0.01), orientation_known=False)


def first_black(m: Picture) -> Picture:
    return replace(m, pixels=np.zeros_like(m.pixels)) if m.t < 1.0 else m


def same_picture(first: list[Picture]) -> Callable[[Message], object]:
    """The camera stabilises: what turns is taken out of the image again."""

    def change(m: Picture) -> Picture:
        first.append(m)
        shift = -round(float(yaw(m.t)) / math.tau * m.pixels.shape[1])
        return replace(m, pixels=np.roll(m.pixels, shift, axis=1))

    return of(Picture, change)


def crowd(m: Picture) -> Picture:
    """All that is seen goes round by 0.1 rad/s while people walk, for 3 of the 7 s."""
    extra = 0.1 * float(np.clip(m.t - 2.5, 0.0, 3.0))
    return replace(m, pixels=np.roll(m.pixels, round(extra / math.tau * m.pixels.shape[1]), axis=1))


def hung(since: float) -> Callable[[Message], object]:
    last: list[Imu] = []

    def change(m: Imu) -> Imu:
        if m.t < since:
            last[:] = [m]
        return m if m.t < since else replace(m, rate=last[0].rate)

    return of(Imu, change)


SQUEEZED = {"half a circle": lambda p: cv2.resize(p[:, 64:192], (256, 128))}
SQUEEZED["two halves side by side"] = lambda p: np.hstack([cv2.resize(p, (128, 128))] * 2)

SITUATIONS = {
    "nothing wrong": Situation(sigma=0.5),
    "gravity removed from the accelerometer": Situation(of(Imu, without_gravity), NO_IMAGE, sigma=8.0),
    "gravity removed, with camera": Situation(of(Imu, without_gravity), NO_ODOMETRY, sigma=1.0),
    "gravity removed, IMU pitched": Situation(
        of(Imu, pitched_without_gravity), NO_IMAGE, sigma=10.0, codes=("vertical_unknown",)
    ),
    "gravity removed, IMU pitched, with camera": Situation(
        of(Imu, pitched_without_gravity), NO_ODOMETRY, sigma=0.5, codes=("vertical_unknown",)
    ),
    "accelerometer of the wrong sign": Situation(
        of(Imu, lambda m: replace(m, force=tuple(-x for x in m.force))), NO_ODOMETRY, codes=("sensors_disagree_sign",)
    ),
    "accelerometer in g": Situation(
        of(Imu, lambda m: replace(m, force=tuple(x / 9.81 for x in m.force))), sigma=1.0, codes=("accelerometer_units",)
    ),
    "gyro in deg/s, all sensors": Situation(gyro(lambda w, t: math.degrees(w)), sigma=3.0, codes=("gyro_units",)),
    "gyro in deg/s, with camera": Situation(gyro(lambda w, t: math.degrees(w)), NO_ODOMETRY, codes=("gyro_units",)),
    "gyro in deg/s, with tracks": Situation(gyro(lambda w, t: math.degrees(w)), NO_IMAGE, codes=("gyro_units",)),
    "gyro of 3 deg/s at rest, with tracks": Situation(
        gyro(lambda w, t: w + 0.05), NO_IMAGE, sigma=15.0, codes=("sensors_disagree_bias",)
    ),
    "gyro of 17 deg/s at rest, with tracks": Situation(
        gyro(lambda w, t: w + 0.3), NO_IMAGE, sigma=15.0, codes=("sensors_disagree_bias",)
    ),
    "gyro with spikes, with camera": Situation(spikes(0.02, -20.0), NO_ODOMETRY, sigma=0.5, codes=("sensor_spikes",)),
    "gyro with many spikes, with camera": Situation(
        spikes(0.05, 8.0), NO_ODOMETRY, sigma=0.5, codes=("sensor_spikes",)
    ),
    "gyro and accelerometer in turn": Situation(of(Imu, in_turn), sigma=1.0, codes=("imu_half_messages",)),
    "accelerometer, then gyro, of one stamp": Situation(of(Imu, in_two), sigma=1.0, codes=("imu_half_messages",)),
    "gyro of impossible numbers": Situation(gyro(lambda w, t: 1e300), sigma=1.0, codes=("samples_lost",)),
    "odometry without numbers": Situation(
        of(Tracks, lambda m: replace(m, rate=math.nan)), sigma=1.0, codes=("samples_lost",)
    ),
    "orientation that never changes, IMU pitched": Situation(of(Imu, pitched), sigma=1.0),
    "gyro without accelerations": Situation(
        of(Imu, lambda m: replace(m, force=(0.0, 0.0, 0.0), force_known=False)), sigma=1.0, codes=("vertical_unknown",)
    ),
    "IMU stamped since power-up": Situation(
        imu_clock(lambda t: t + (BOOT_NS - START_NS) * 1e-9), NO_ODOMETRY, codes=("clock_mismatch",),
        refuse="in common|overlap",
    ),
    "images stamped since power-up": Situation(
        imu_clock(lambda t: t + (BOOT_NS - START_NS) * 1e-9, Picture), sigma=8.0, codes=("clock_mismatch",),
        refuse="in common|overlap",
    ),
    "IMU stamps of 1980 for a second": Situation(
        imu_clock(lambda t: t if not 3.0 <= t < 4.0 else t - 1.4e9), sigma=1.0, codes=("stamps_wrong",)
    ),
    "IMU clock goes back by 3 s": Situation(
        imu_clock(lambda t: t if t < 4.0 else t - 3.0), sigma=3.0,
        codes=("stamps_not_increasing", "stamps_wrong", "clock_mismatch", "sensor_silent"),
    ),
    "IMU half a second late": Situation(
        imu_clock(lambda t: t + 0.5), sigma=5.0, codes=("sensors_disagree_time", "clock_mismatch")
    ),
    "all clocks set ahead by 3 s in mid turn": Situation(clocks_ahead(3.0), codes=("turn_lost",)),
    "all clocks set ahead by 3 s in mid turn, no camera": Situation(
        clocks_ahead(3.0), NO_IMAGE, codes=("turn_lost",)
    ),
    "gyro scale off by 1.8 %": Situation(gyro(lambda w, t: 1.018 * w), sigma=1.0),
    "gyro hangs at one number": Situation(hung(2.0), sigma=3.0, codes=("gyro_stuck",)),
    "gyro hangs at one number, with camera": Situation(hung(2.0), NO_ODOMETRY, sigma=3.0, codes=("gyro_stuck",)),
    "gyro hangs at one number, with tracks": Situation(hung(2.0), NO_IMAGE, codes=("gyro_stuck",)),
    "gyro at its end stop": Situation(
        gyro(lambda w, t: float(np.clip(w, -0.5, 0.5))), sigma=3.0, codes=("gyro_saturated",)
    ),
    "gyro at its end stop, with camera": Situation(
        gyro(lambda w, t: min(max(w, -0.5), 0.5)), NO_ODOMETRY, sigma=1.0, codes=("gyro_saturated",)
    ),
    "gyro at its end stop, with tracks": Situation(
        gyro(lambda w, t: float(np.clip(w, -0.5, 0.5))), NO_IMAGE, codes=("gyro_saturated",)
    ),
    "odometry says nothing": Situation(
        of(Tracks, lambda m: replace(m, yaw=0.0, rate=0.0)), sigma=1.0, codes=("odometry_silent",)
    ),
    "odometry runs backwards in time": Situation(
        imu_clock(lambda t: 7.0 - t, Tracks), sigma=3.0,
        codes=("stamps_not_increasing", "sensors_disagree", "sensors_disagree_sign", "sensors_disagree_time"),
    ),
    "odometry of the wrong sign": Situation(
        of(Tracks, lambda m: replace(m, yaw=-m.yaw, rate=-m.rate)), sigma=1.0, codes=("sensors_disagree_sign",)
    ),
    "odometry in degrees": Situation(
        of(Tracks, lambda m: replace(m, yaw=math.degrees(m.yaw), rate=math.degrees(m.rate))), sigma=0.5
    ),
    "mirrored panoramas, tracks": Situation(
        pixels(lambda p: p[:, ::-1]), NO_GYRO, codes=("images_mirrored", "sensors_disagree_sign")
    ),
    "mirrored panoramas, gyro": Situation(
        pixels(lambda p: p[:, ::-1]), NO_ODOMETRY, codes=("images_mirrored", "sensors_disagree_sign")
    ),
    "mirrored panoramas, all": Situation(pixels(lambda p: p[:, ::-1]), sigma=3.0, codes=("images_mirrored",)),
    "camera upside down, all": Situation(pixels(lambda p: p[::-1, ::-1]), sigma=3.0, codes=("images_mirrored",)),
    "half a circle, tracks": Situation(pixels(SQUEEZED["half a circle"]), NO_GYRO, codes=("not_full_circle",)),
    "half a circle, all": Situation(pixels(SQUEEZED["half a circle"]), codes=("not_full_circle",)),
    "right half of the circle, all": Situation(pixels(right_half), codes=("not_full_circle",)),
    "right half of the circle, gyro": Situation(pixels(right_half), NO_ODOMETRY, codes=("not_full_circle",)),
    "two halves side by side": Situation(pixels(SQUEEZED["two halves side by side"]), codes=("not_full_circle",)),
    "letters written into every image, all": Situation(pixels(lettered), sigma=3.0, codes=("images_do_not_turn",)),
    "images that do not turn, all": Situation(same_picture([]), sigma=3.0, codes=("images_do_not_turn",)),
    "images that do not turn, gyro": Situation(same_picture([]), NO_ODOMETRY, codes=("images_do_not_turn",)),
    "images that do not turn, tracks": Situation(same_picture([]), NO_GYRO, codes=("images_do_not_turn",)),
    "all images of one stamp": Situation(imu_clock(lambda t: 1.0, Picture), codes=("stamps_not_increasing",)),
    "stamps cut to whole seconds": Situation(
        imu_clock(lambda t: float(math.floor(t)), Picture), sigma=8.0, codes=("stamps_not_increasing",)
    ),
    "nanoseconds beyond a second": Situation(
        of(Picture, lambda m: replace(m, raw_stamp=(m.t_ns // 10**9 - 1, m.t_ns % 10**9 + 10**9))), sigma=3.0
    ),
    "a first second of black images": Situation(of(Picture, first_black), sigma=0.5),
    "a crowd that walks one way": Situation(
        of(Picture, crowd), sigma=3.0, codes=("sensors_disagree", "sensors_disagree_bias")
    ),
    "a camera of 1.5 pictures a second": Situation(sigma=1.0, rates={"image_hz": 1.5}),
    "a camera of 1.5 pictures a second, no gyro": Situation(arguments=NO_GYRO, rates={"image_hz": 1.5}),
}  # fmt: skip

# What fails today, and how far off it is; run all the same. Whoever mends one takes it out of here.
PENDING: dict[str, str] = {
    "IMU half a second late": "named; off by 0.05 deg, sigma 19: without the gyro the end is predicted",
}


def fused(bag, folder, capsys, arguments: Iterable[str]) -> tuple[int, str, dict]:
    """Exit code, what the screen said, and summary.json ({} where there is none)."""
    out = folder / "out"
    code = main(["fuse", str(bag), "--out", str(out), *arguments])
    screen = capsys.readouterr()
    summary = out / "summary.json"
    return code, screen.out + screen.err, json.loads(summary.read_text()) if summary.is_file() else {}


def check(summary: dict, screen: str, case: Situation, turned_deg: float = TURNED_DEG) -> None:
    """The yaw within 3 sigma, sigma bounded, and a warning of an expected code, whose text is on the screen."""
    yaw_deg, sigma_deg = (summary["yaw"]["fused"][key] for key in ("turned_deg", "sigma_deg"))
    codes = [warning["code"] for warning in summary["warnings"]]
    said = f"off by {yaw_deg - turned_deg:.2f} deg, sigma {sigma_deg:.2f}, warnings {codes}"
    assert abs(yaw_deg - turned_deg) <= 3.0 * max(sigma_deg, FLOOR_DEG), said
    assert sigma_deg <= case.sigma, said
    if case.codes:
        assert set(codes) & set(case.codes), said
        assert any(code in screen for code in codes), screen


def _marked(name: str) -> Any:
    """A situation, expected to fail where it is pending: if it passes, that is an error, too."""
    marks = [pytest.mark.xfail(strict=True, reason=PENDING[name])] if name in PENDING else []
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [_marked(name) for name in SITUATIONS])
def test_bag_as_reported(name, tmp_path, capsys):
    case = SITUATIONS[name]
    bag = write(tmp_path / "bag", changed(messages(**case.rates), case.change))
    code, screen, summary = fused(bag, tmp_path, capsys, case.arguments)
    assert "Traceback" not in screen
    if code:
        assert code == 1
        assert case.refuse, screen
        assert re.search(case.refuse, screen, re.IGNORECASE), screen
        assert len(screen.strip().splitlines()) == 1
        assert not summary
    else:
        check(summary, screen, case)


def test_recorder_that_was_killed_leaves_a_log_that_is_read_or_missed(tmp_path, capsys):
    """The second half of an sqlite bag is still in the write-ahead log beside it."""
    whole = write(tmp_path / "whole", messages(), storage="sqlite3")
    database = next(whole.glob("*.db3"))
    with sqlite3.connect(database) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA wal_autocheckpoint=0")
        columns = "id, topic_id, timestamp, data"
        middle = connection.execute("SELECT max(id) / 2 FROM messages").fetchone()[0]
        rows = connection.execute(f"SELECT {columns} FROM messages WHERE id > ?", (middle,)).fetchall()
        connection.execute("DELETE FROM messages WHERE id > ?", (middle,))
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.executemany(f"INSERT INTO messages({columns}) VALUES (?, ?, ?, ?)", rows)
        connection.commit()
        shutil.copytree(whole, tmp_path / "copied")  # while it is open: closing would empty the log
    code, screen, summary = fused(tmp_path / "copied", tmp_path, capsys, ())
    if code:
        assert re.search(r"wal|incomplete", screen, re.IGNORECASE), screen
        assert len(screen.strip().splitlines()) == 1
    else:
        check(summary, screen, Situation(sigma=0.5))


def test_bag_whose_metadata_counts_more_than_it_holds_is_fused_or_missed(tmp_path, capsys):
    whole = write(tmp_path / "bag", messages(), storage="sqlite3")
    database = next(whole.glob("*.db3"))
    with sqlite3.connect(database) as connection:
        middle = connection.execute("SELECT max(id) / 2 FROM messages").fetchone()[0]
        connection.execute("DELETE FROM messages WHERE id > ?", (middle,))
    code, screen, summary = fused(whole, tmp_path, capsys, ())
    if code:
        assert len(screen.strip().splitlines()) == 1
        assert re.search(r"metadata|incomplete|messages", screen), screen
    else:
        assert {warning["code"] for warning in summary["warnings"]} & {"samples_lost"}, summary["warnings"]
