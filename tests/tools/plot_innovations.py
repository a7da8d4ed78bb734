"""Draw the innovations of docs/filter.md, without faults and with two.

PYTHONPATH=tests python -m tools.plot_innovations [PNG]
"""

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from robot_drive import robot_drive

from fusion import GyroSample, OdometrySample, Sensor, Verdict, YawFusion

PAGE = Path(__file__).parents[2] / "docs" / "figures" / "innovations.png"
NAMES = {Sensor.GYRO: "gyro, rad/s", Sensor.TRACKS: "tracks, rad", Sensor.COMPASS: "compass, rad"}
RANGES = {Sensor.GYRO: 0.1, Sensor.TRACKS: 0.6, Sensor.COMPASS: 0.02}


def reports(drive):
    """Every report of every sensor, and the yaw error with its sigma, in degrees."""
    fusion, seen, errors = YawFusion(), {sensor: [] for sensor in Sensor}, []
    for sample in drive.samples:
        fusion.add(sample)
        for sensor, report in fusion.reports().items():
            if report is not None and (not seen[sensor] or seen[sensor][-1] is not report):
                seen[sensor].append(report)
        estimate = fusion.estimate()
        errors.append((1e-9 * estimate.t_ns, np.degrees(drive.error(estimate)), np.degrees(estimate.yaw_variance**0.5)))
    return seen, np.array(errors)


def draw_innovations(axes, found, sensor):
    """Innovations, the 3-sigma band they should keep to, and in red those that were not used."""
    t = np.array([1e-9 * report.t_ns for report in found])
    innovation = np.array([report.innovation for report in found])
    band = 3.0 * np.array([report.innovation_sigma for report in found])
    refused = np.array([report.verdict is not Verdict.ACCEPTED for report in found])
    axes.fill_between(t, -band, band, color="0.85", linewidth=0)
    axes.plot(t[~refused], innovation[~refused], ".", color="tab:blue", markersize=1.5)
    axes.plot(t[refused], innovation[refused], ".", color="tab:red", markersize=2.5)
    axes.set_ylim(-RANGES[sensor], RANGES[sensor])
    axes.set_ylabel(NAMES[sensor])


def main():
    """Write the picture."""
    parser = argparse.ArgumentParser(
        "plot_innovations", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("png", nargs="?", type=Path, default=PAGE, help="where it is written; the one of the docs")
    path = parser.parse_args().png
    sound = robot_drive(0, seconds=40.0)
    faulty = sound.changed(lambda s: replace(s, yaw_rate=s.yaw_rate + 0.3), GyroSample, 26.0)
    faulty = faulty.changed(lambda s: replace(s, yaw_rate=0.0, yaw=0.5), OdometrySample, 10.0, 20.0)
    figure, axes = plt.subplots(4, 2, figsize=(9.0, 7.0), sharex=True, sharey="row")
    titles = "no fault", "two faults: tracks stuck 10..20 s, gyro bias jumps at 26 s"
    for column, (drive, title) in enumerate(zip((sound, faulty), titles, strict=True)):
        found, errors = reports(drive)
        for row, sensor in enumerate(Sensor):
            draw_innovations(axes[row, column], found[sensor], sensor)
        t, error, sigma = errors[::20].T
        axes[3, column].fill_between(t, -3.0 * sigma, 3.0 * sigma, color="0.85", linewidth=0)
        axes[3, column].plot(t, error, color="tab:green", linewidth=0.8)
        axes[3, column].set_ylim(-1.5, 1.5)
        axes[0, column].set_title(title, fontsize="medium")
        axes[3, column].set_xlabel("s")
    axes[3, 0].set_ylabel("yaw error, deg")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    print(path)


if __name__ == "__main__":
    main()
