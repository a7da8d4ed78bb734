"""Commands beside the main ones, each with its arguments only; the work is in the module of each."""

from __future__ import annotations

from pathlib import Path

import click

from fusion.offline.sensor_options import PATH
from fusion.offline.verbosity import QuietCommand, say


@click.command(cls=QuietCommand, short_help="One sortable table of a folder of results.")
@click.argument("results", type=PATH)
def report(results: Path) -> None:
    """Write RESULTS/report.html: a row per folder of results in RESULTS, sortable, linked to each run's report."""
    from fusion.offline.report.table import report_of_folder

    written, count = report_of_folder(results)
    say(f"{count} runs in {written}")


@click.command(cls=QuietCommand, short_help="Noise of a standing gyro, for --config and Kalibr.")
@click.argument("imu", type=PATH)
@click.option("--gyro-topic", "topic", metavar="T", help="Gyro, sensor_msgs/Imu.")
@click.option(
    "--out",
    type=PATH,
    metavar="YAML",
    default=Path("gyro.yaml"),
    show_default=True,
    help="Parameters to write, ready for --config.",
)
@click.option("--kalibr", type=PATH, metavar="YAML", help="Write Kalibr's imu.yaml, too.")
@click.option("--force", is_flag=True, help="Write where something else is than an earlier result.")
def allan(imu: Path, topic: str | None, out: Path, kalibr: Path | None, force: bool) -> None:
    """Noise density, bias instability and random walk of the standing gyro in IMU, a bag: by its Allan deviation.

    IMU may be Kalibr's imu.yaml, whose noises are written as parameters then.
    """
    from fusion.offline.allan_bag import noise_of

    say(noise_of(imu, topic, out, kalibr, force=force))
