"""Options of commands that name the sensors: their topics, or files beside a video or a folder of images."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from fusion.offline.sensor_columns import GYRO_COLUMNS, ODOMETRY_COLUMNS, TRUTH_COLUMNS

Command = TypeVar("Command", bound=Callable[..., None])
PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is told where it is read, in our words


class Moment(click.ParamType):  # type: ignore[type-arg, unused-ignore]  # generic since click 8.4
    """A time in seconds, as exact nanoseconds."""

    name = "s"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """From text; a usage error where it is none."""
        from fusion.offline.sensor_csv import nanoseconds

        try:
            return value if isinstance(value, int) else nanoseconds(str(value))
        except ValueError:
            self.fail(f"{value!r} is no time in seconds, zero or later", param, ctx)


def sensor_file_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options, and their values as its argument `sensors`."""

    @functools.wraps(command)
    def with_files(
        *arguments: Any,
        gyro_file: Path | None,
        odometry_file: Path | None,
        truth_file: Path | None,
        video_start: int | None,
        **others: Any,
    ) -> None:
        from fusion.offline.image_files import EMBEDDED, SensorFiles

        gyro = EMBEDDED if gyro_file == Path(EMBEDDED) else gyro_file
        command(*arguments, sensors=SensorFiles(gyro, odometry_file, truth_file, video_start), **others)

    for option in (
        click.option(
            "--video-start",
            type=Moment(),
            metavar="S",
            help="Time of a video's first frame by the clock of the CSV files, s  [default: 0]",
        ),
        click.option("--truth", "truth_file", type=PATH, metavar="CSV", help=f"Beside a video: {TRUTH_COLUMNS}."),
        click.option(
            "--odometry", "odometry_file", type=PATH, metavar="CSV", help=f"Beside a video: {ODOMETRY_COLUMNS}."
        ),
        click.option(
            "--gyro",
            "gyro_file",
            type=PATH,
            metavar="CSV",
            help=f"Beside a video or a folder of images: {GYRO_COLUMNS}; 'embedded': the gyro inside the video.",
        ),
    ):
        with_files = option(with_files)
    return with_files


def topic_options(command: Command) -> Command:
    """Options that name topics; each is found by its type when left out."""
    for sensor, what in (
        ("truth", "Ground truth, nav_msgs/Odometry."),
        ("odometry", "Track odometry, nav_msgs/Odometry."),
        ("gyro", "Gyro, sensor_msgs/Imu."),
        ("image", "Panoramas, sensor_msgs/Image or CompressedImage."),
    ):
        text = f"{what} 'none' leaves it out."
        command = click.option(f"--{sensor}-topic", sensor, metavar="T", help=text)(command)
    return command
