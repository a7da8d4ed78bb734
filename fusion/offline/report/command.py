"""``visual-compass report``: a folder of results as one sortable table."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="One sortable table of a folder of results.")
@click.argument("results", type=click.Path(path_type=Path))
def report(results: Path) -> None:
    """Write RESULTS/report.html: a row per folder of results in RESULTS, sortable, linked to each run's report."""
    from fusion.offline.report.table import report_of_folder

    written, count = report_of_folder(results)
    click.echo(f"{count} runs in {written}")
