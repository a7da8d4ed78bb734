"""The command line: arguments here, the work in the module of each command."""

from __future__ import annotations

import atexit
import gc
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from compass.errors import ConfigError, VisualCompassError
from fusion.offline.commands import allan, report
from fusion.offline.evaluate_command import evaluate
from fusion.offline.garbage import collect_seldom
from fusion.offline.interruption import Interrupted, interruptible
from fusion.offline.sensor_options import PATH, sensor_file_options, topic_options
from fusion.offline.verbosity import QuietGroup, anything_printable, output_checked, say

if TYPE_CHECKING:
    from fusion.offline.image_files import SensorFiles

# Our matrices and strips are small: more threads of BLAS and OpenCV than one only wait for each other. Before numpy and
# cv2 are imported, and inherited.
for variable in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(variable, "1")
# Images of megabytes come and go: glibc is to keep their memory, not to fetch its pages from the kernel for each one.
# Only processes that this one starts read it.
os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(32 << 20))
os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(128 << 20))

_FORCE = click.option("--force", is_flag=True, help="Write where something else is than an earlier result.")


@click.group(cls=QuietGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="visual-compass")
def cli() -> None:
    """Yaw of a tracked robot from a 360-degree camera, a gyro and track odometry."""


@cli.command(short_help="Fuse bags: yaw as CSV, TUM, MCAP, a summary and a plot.")
@click.argument("bags", nargs=-1, required=True, metavar="BAG...")
@click.option("--out", type=PATH, metavar="DIR", help="Folder for the results  [default: ./<bag>_yaw; of many: .]")
@click.option("--config", type=PATH, metavar="YAML", help="Parameters in ROS form; see config/visual_compass.yaml.")
@click.option("--smooth", is_flag=True, help="Add the fixed-interval (RTS) smoother.")
@click.option(
    "--report", "with_report", is_flag=True, help="Add report.html: everything zoomable on one page, without network."
)
@click.option("--rerun", is_flag=True, help="Add run.rrd for the Rerun viewer.")
@click.option("--start", type=float, metavar="S", help="Fuse from here on, s from the first sample.")
@click.option("--end", type=float, metavar="S", help="Fuse up to here, s from the first sample.")
@click.option("--jobs", type=click.IntRange(1), metavar="N", help="Processes for many bags  [default: one per core]")
@click.option("--scheduler", metavar="ADDRESS", help="Fuse on the workers of a Dask scheduler, tcp://host:8786.")
@_FORCE
@sensor_file_options
@topic_options
def fuse(
    bags: tuple[str, ...],
    out: Path | None,
    config: Path | None,
    smooth: bool,
    with_report: bool,
    rerun: bool,
    start: float | None,
    end: float | None,
    jobs: int | None,
    scheduler: str | None,
    force: bool,
    image: str | None,
    gyro: str | None,
    odometry: str | None,
    truth: str | None,
    sensors: SensorFiles,
) -> None:
    """Fuse each BAG (ROS 1, rosbag2 sqlite3 or MCAP): yaw.csv, *.tum, result.mcap, summary.json and yaw.png.

    BAG may also be a folder with bags below it, a pattern in quotes such as '2024-*/*.mcap', or a URL. Of many bags, or
    with --jobs or --scheduler, each gets a folder of its own in --out, with one summary.csv for all; what is finished
    is skipped, a bag that fails does not stop the others.

    A BAG may also be a video, or a folder of images with a times.csv (file; t in s, or t_ns).
    """
    from fusion.offline.fuse_command import fuse_named
    from fusion.offline.topics import TopicRequest
    from fusion.settings import load_settings

    if end == 0.0:  # all, in a parameter file
        raise ConfigError("--end: 0 s is not after the start; leave it out to fuse all")
    given = {"offline.smooth": smooth or None, "offline.start": start, "offline.end": end}
    settings = load_settings(config, {name: value for name, value in given.items() if value is not None})
    request = TopicRequest(image, gyro, odometry, truth)
    inputs = [config] if config else []
    options: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "force": force, "inputs": inputs}
    fuse_named(bags, out, settings, request, sensors, report=with_report, rerun=rerun, **options)


@cli.command(short_help="What is in a bag, and what is wrong with it.")
@click.argument("bag", type=PATH)
@click.option("--roi-preview", type=PATH, metavar="PNG", help="Draw the region of interest over a frame.")
@click.option("--config", type=PATH, metavar="YAML", help="Parameters in ROS form, for the region of interest.")
@click.option("--image-topic", "image", metavar="T", help="Panoramas to preview.")
@_FORCE
def inspect(bag: Path, roi_preview: Path | None, config: Path | None, image: str | None, force: bool) -> None:
    """Show topics, rates, gaps and faulty stamps of BAG, its image size, what 'fuse' would take, and what is wrong.

    Of a video, or a folder of images with a times.csv: size, rate, duration, what is wrong, and what to type next.
    """
    from fusion.offline.atomic_output import refuse_existing
    from fusion.offline.inspect_command import inspected
    from fusion.offline.topics import TopicRequest
    from fusion.settings import load_settings

    refuse_existing(roi_preview, force=force, inputs=[bag, config])
    click.echo(inspected(bag, load_settings(config), TopicRequest(image=image), roi_preview))


@cli.command(short_help="Write a simulated experiment as a bag with ground truth.")
@click.argument("experiment", required=False)
@click.option("--out", type=PATH, metavar="BAG", help="Bag to write: name.mcap, or a name for a rosbag2 folder.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of noise, slip and world.")
@click.option("--config", type=PATH, metavar="YAML", help="Parameters in ROS form, for the topics' names.")
@_FORCE
def simulate(experiment: str | None, out: Path | None, seed: int, config: Path | None, force: bool) -> None:
    """Simulate EXPERIMENT and write it as a bag with ground truth; without EXPERIMENT, list them."""
    from fusion.offline.demo import experiment_list, simulate_bag
    from fusion.settings import load_settings

    if experiment is None:
        click.echo(experiment_list())
        return
    out = out or Path(f"{experiment}.mcap")
    simulate_bag(experiment, seed, out, load_settings(config), force=force)
    say(f"{out}: {experiment}, seed {seed}")


@cli.command(short_help="Propose settings from a recording of your own.")
@click.argument("bag", type=PATH)
@click.option(
    "--out",
    type=PATH,
    metavar="YAML",
    default=Path("calibrated.yaml"),
    show_default=True,
    help="Settings to write, ready for --config.",
)
@click.option("--mask-preview", type=PATH, metavar="PNG", help="Draw what belongs to the robot over a frame.")
@click.option("--config", type=PATH, metavar="YAML", help="Parameters in ROS form to start from.")
@_FORCE
@sensor_file_options
@topic_options
def calibrate(
    bag: Path,
    out: Path,
    mask_preview: Path | None,
    config: Path | None,
    force: bool,
    image: str | None,
    gyro: str | None,
    odometry: str | None,
    truth: str | None,
    sensors: SensorFiles,
) -> None:
    """Propose region, mask, forward column and noises from BAG, in which the robot turns, drives and stands."""
    from fusion.offline.calibrate import calibrate_bag
    from fusion.offline.topics import TopicRequest
    from fusion.settings import load_settings

    request = TopicRequest(image, gyro, odometry, truth)
    say(calibrate_bag(bag, load_settings(config), request, out, mask_preview, force=force, sensors=sensors))


@cli.command(short_help="Simulate a short drive, fuse it, compare with the truth.")
@click.option(
    "--out", type=PATH, metavar="DIR", default=Path("demo"), show_default=True, help="Folder for bag and results."
)
@_FORCE
def demo(out: Path, force: bool) -> None:
    """Simulate a short drive, write it as a bag, fuse that bag and compare with the truth."""
    from fusion.offline.demo import run_demo
    from fusion.offline.summary import warning_lines, yaw_table
    from fusion.settings import Settings

    fused = run_demo(out, Settings(), force=force)
    say(yaw_table(fused.summary))
    for line in warning_lines(fused.summary["warnings"]):
        say(line)
    say(f"bag {out / 'demo.mcap'}, results in {fused.folder}/, plot {fused.folder / 'yaw.png'}")


@cli.command(short_help="Print the JSON Schema of parameter files or of summary.json.")
@click.argument("what", type=click.Choice(["settings", "summary"]))
def schema(what: str) -> None:
    """Print the JSON Schema (2020-12) of parameter files (settings) or of summary.json (summary)."""
    import json

    from fusion.offline.schemas import settings_schema, summary_schema

    click.echo(json.dumps(settings_schema() if what == "settings" else summary_schema(), indent=2))


for _command in (evaluate, report, allan):
    cli.add_command(_command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``visual-compass``: the only place that prints errors and chooses the exit code."""
    if arguments is None:  # the process is this command's: nothing is searched once more for garbage as it ends
        atexit.register(gc.freeze)
    with anything_printable():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    level, collecting = logging.getLogger().level, gc.get_threshold()
    collect_seldom()
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        with interruptible(), output_checked():
            cli.main(arguments, prog_name="visual-compass", standalone_mode=False)
    except VisualCompassError as error:
        click.echo(f"visual-compass: {' '.join(str(error).split())}", err=True)
        return 1
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except Interrupted as interrupted:
        click.echo(f"visual-compass: interrupted, {interrupted.left}", err=True)
        return 128 + interrupted.number
    finally:
        logging.getLogger().setLevel(level)  # of who calls it from Python
        gc.set_threshold(*collecting)
    return 0


if __name__ == "__main__":
    sys.exit(main())
