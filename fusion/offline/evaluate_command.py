"""``visual-compass evaluate``: its arguments; the work is in ``fusion.offline.evaluation``."""

from __future__ import annotations

from pathlib import Path

import click

from compass.config import METHODS
from fusion.offline.sensor_options import PATH, topic_options
from fusion.offline.verbosity import QuietCommand


@click.command(cls=QuietCommand, short_help="Score every compass, each sensor and the fused yaw.")
@click.argument("what", nargs=-1)
@click.option("--seeds", type=click.IntRange(1), default=1, show_default=True, help="Drives of each experiment.")
@click.option("--first-seed", type=click.IntRange(0), default=0, show_default=True, help="Go on where a run ended.")
@click.option(
    "--worlds",
    metavar="W",
    default="held-out",
    show_default=True,
    help="held-out: where no constant was chosen; tuned: each experiment's own place; all; or one held-out place.",
)
@click.option("--json", "json_file", type=PATH, metavar="FILE", help="Write every outcome as JSON.")
@click.option("--markdown", "markdown_file", type=PATH, metavar="FILE", help="Write the accuracy section of a file.")
@click.option("--headline", "headline_file", type=PATH, metavar="FILE", help="Write six lines of results into a file.")
@click.option(
    "--metric",
    type=click.Choice(["all", "final", "rms", "worst", "per_m", "per_turn"]),
    default="all",
    show_default=True,
    help="All in a long table, or one in a short.",
)
@click.option("--smooth", is_flag=True, help="Score the fixed-interval (RTS) smoother, too.")
@click.option(
    "--methods",
    "ours",
    metavar="M,M",
    default=",".join(METHODS),
    show_default=True,
    help="Which of ours to score; the configured one is always.",
)
@click.option(
    "--method",
    "methods",
    multiple=True,
    metavar="M:F",
    help="A method of your own, module:function, beside ours; may be repeated.",
)
@click.option(
    "--yaw", "yaws", type=PATH, multiple=True, metavar="TUM", help="A yaw of your own for the bag; may be repeated."
)
@click.option("--workers", type=click.IntRange(1), default=None, help="Processes  [default: one per core]")
@click.option("--config", type=PATH, metavar="YAML", help="Parameters in ROS form.")
@click.option("--force", is_flag=True, help="Write where something else is than an earlier result.")
@topic_options
def evaluate(
    what: tuple[str, ...],
    seeds: int,
    first_seed: int,
    worlds: str,
    json_file: Path | None,
    markdown_file: Path | None,
    headline_file: Path | None,
    metric: str,
    smooth: bool,
    ours: str,
    methods: tuple[str, ...],
    yaws: tuple[Path, ...],
    workers: int | None,
    config: Path | None,
    force: bool,
    image: str | None,
    gyro: str | None,
    odometry: str | None,
    truth: str | None,
) -> None:
    """Score every compass, each sensor and the fused yaw.

    WHAT are names of experiments, bags with ground truth, and files of earlier --json, which are joined into one table;
    without, all experiments. On
    experiments the compass's methods are informed when images were exposed; "raw compass", what is published, goes by
    their stamps, as fused does.
    """
    from fusion.offline.evaluation.command import run_evaluation
    from fusion.offline.topics import TopicRequest
    from fusion.settings import load_settings

    text = run_evaluation(
        what,
        range(first_seed, first_seed + seeds),
        load_settings(config),
        TopicRequest(image, gyro, odometry, truth),
        metric,
        workers=workers,
        smooth=smooth,
        worlds=worlds,
        methods=(*(name.strip() for name in ours.split(",")), *methods),
        yaws=yaws,
        json_file=json_file,
        markdown_file=markdown_file,
        headline_file=headline_file,
        force=force,
    )
    click.echo(text)
