"""``visual-compass allan``: noises of the standing gyro in a bag, for ``--config`` and for Kalibr."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from fusion.messages import NO_VECTOR, MessageError, imu_reading
from fusion.offline.allan import AllanCurve, AllanError, allan_curve, check_standing, longest_stretch
from fusion.offline.atomic_output import refuse_existing, staged_file
from fusion.offline.bag import Bag
from fusion.offline.console import progress_bar, shown_name, table
from fusion.offline.kalibr import KALIBR_HEAD, KalibrImu, read_kalibr
from fusion.offline.streams import Floats, Times
from fusion.offline.topics import TopicRequest, choose_topics
from fusion.settings import NONE, TopicSettings

AXES = ("gyro x", "gyro y", "gyro z", "accelerometer x", "accelerometer y", "accelerometer z")
HEAD = "# Noise of the gyro, by visual-compass allan from"


def noise_of(path: Path, topic: str | None, out: Path, kalibr: Path | None, *, force: bool = False) -> str:
    """Write the noises of a standing IMU, or those of Kalibr's file, as parameters; gives the table for the screen.

    Raises
    ------
    VisualCompassError
        The recording cannot be used, or a place cannot be written to.
    """
    refuse_existing(out, begins=HEAD.encode(), force=force, inputs=[path])
    refuse_existing(kalibr, begins=KALIBR_HEAD.encode(), force=force, inputs=[path])
    if path.suffix in (".yaml", ".yml"):
        imu = read_kalibr(path)
        text = f"{path}: Kalibr's, at {imu.update_rate:g} Hz"
    else:
        try:
            imu, text = _measured(path, topic)
        except AllanError as error:
            raise AllanError(f"{path}: {error}") from None
    with staged_file(out) as staged:
        staged.write_text(_parameters(imu, shown_name(path)), encoding="utf-8")
    if kalibr is not None:
        with staged_file(kalibr) as staged:
            staged.write_text(imu.as_yaml(), encoding="utf-8")
    return f"{text}\nparameters in {out}" + (f", for Kalibr in {kalibr}" if kalibr else "")


def _measured(path: Path, topic: str | None) -> tuple[KalibrImu, str]:
    with Bag(path) as bag:
        chosen = choose_topics(bag, TopicSettings(), TopicRequest(NONE, topic, NONE, NONE)).gyro
        if chosen is None:
            raise AllanError("holds no sensor_msgs/Imu")
        t_ns, readings = _read(bag, chosen.name, chosen.count)
    finite = np.isfinite(readings[:, :3]).all(axis=1)
    t_ns, readings = t_ns[finite], readings[finite]
    order = np.argsort(t_ns, kind="stable")
    t_ns, readings = t_ns[order], readings[order]
    part, rate_hz = longest_stretch(t_ns)
    readings = readings[part]
    check_standing(readings[:, :3], rate_hz)
    curves = {name: allan_curve(readings[:, i], rate_hz) for i, name in enumerate(AXES) if _changes(readings[:, i])}
    gyros, others = ([curve for name, curve in curves.items() if name.startswith(kind)] for kind in ("gyro", "acc"))
    if not gyros:
        raise AllanError("the gyro says one and the same number all the time: simulated, switched off, or filtered")
    imu = KalibrImu(
        max(one.density for one in gyros),
        max(one.random_walk or 0.0 for one in gyros),
        rate_hz,
        chosen.name,
        max(one.density for one in others) if others else None,
        max(one.random_walk or 0.0 for one in others) if others else None,
        {
            f"{name}_random_walk": max(one.walk_bound for one in axes)
            for name, axes in (("gyroscope", gyros), ("accelerometer", others))
            if axes and all(one.random_walk is None for one in axes)
        },
    )
    rows = [_row(name, curve, float(readings[:, AXES.index(name)].mean())) for name, curve in curves.items()]
    header = ["", "mean", "noise density", "instability", "random walk"]
    seconds = len(readings) / rate_hz
    return imu, f"{chosen.name}: {seconds:.0f} s at {rate_hz:.1f} Hz; rad/s and m/s^2\n{table(header, rows)}"


def _read(bag: Bag, topic: str, count: int) -> tuple[Times, Floats]:
    """Stamps (N,), and rates and accelerations (N, 6), NaN where they were not measured."""
    times, rows = [], []
    with progress_bar("reading samples") as progress:
        for index, message in enumerate(bag.messages(topic)):
            try:
                reading = imu_reading(bag.deserialize(message))
            except MessageError:
                continue
            times.append(reading.t_ns)
            rows.append((*(reading.angular_velocity or NO_VECTOR), *(reading.linear_acceleration or NO_VECTOR)))
            if index % 1000 == 0:
                progress(index / max(count, 1))
    if len(times) < 2:
        raise AllanError(f"{topic}: {len(times)} usable messages")
    return np.array(times, np.int64), np.array(rows, np.float64)


def _changes(samples: Floats) -> bool:
    return bool(np.isfinite(samples).all() and np.ptp(samples) > 0.0)


def _row(name: str, curve: AllanCurve, mean: float) -> list[str]:
    return [name, f"{mean:+.3g}", *(_shown(v) for v in (curve.density, curve.instability, curve.random_walk))]


def _shown(value: float | None) -> str:
    return "not seen" if value is None else f"{value:.3g}"


def _parameters(imu: KalibrImu, source: str) -> str:
    """A parameter file; what was not seen stays at its default."""
    sigma = imu.gyroscope_noise_density * math.sqrt(imu.update_rate)
    lines = [f"{HEAD} {source}", "/**:", "  ros__parameters:"]
    if imu.rostopic:
        lines.append(f"    {yaml.safe_dump({'gyro_topic': imu.rostopic}, width=1000).strip()}")
    lines += [
        "    fusion:",
        f"      # {imu.gyroscope_noise_density:.3g} rad/s/sqrt(Hz) at {imu.update_rate:.4g} Hz; the worst axis",
        f"      gyro_sigma: {float(f'{sigma:.3g}')!r}",
    ]
    if imu.gyroscope_random_walk > 0.0:
        lines.append(f"      bias_walk: {float(f'{imu.gyroscope_random_walk:.3g}')!r}")
    else:
        lines.append("      # bias_walk: not seen; an hour of the standing robot shows it")
    return "\n".join(lines) + "\n"
