"""Recordings fused on other machines, through the scheduler of Dask.

Files have to be at the same path on every machine. A recording whose worker dies goes to another one; as its results
appear complete or not at all, it does not matter how often it was begun.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

from compass.errors import VisualCompassError
from fusion.offline.bag_task import FAILED, BagOutcome, BagTask, run_task

log = logging.getLogger(__name__)

MOST_SUBMITTED = 1000  # at a time: the scheduler's memory does not grow with the number of recordings
_ANSWER_WITHIN_S = 20.0


def run_on_cluster(tasks: Sequence[BagTask], scheduler: str) -> Iterator[BagOutcome]:
    """Outcomes as they come. What ends this iteration withdraws what has not begun; what has is finished.

    Raises
    ------
    VisualCompassError
        Dask is missing, or there is no scheduler at that address.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise VisualCompassError("--scheduler needs Dask; pip install 'visual-compass[cluster]'") from None
    try:
        # before a client is half made, which complains with a trace as it goes
        distributed.comm.get_address_host_port(scheduler if "://" in scheduler else f"tcp://{scheduler}", strict=True)
        client = distributed.Client(scheduler, timeout=_ANSWER_WITHIN_S, set_as_default=False)
    except (OSError, ValueError) as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise VisualCompassError(f"{scheduler}: no Dask scheduler answers there: {words}") from error
    if not log.isEnabledFor(logging.INFO):
        for name in ("distributed", "distributed.client"):  # their traces, of what is a line here
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with client:
        if not client.scheduler_info()["workers"]:
            log.warning("%s: no worker is there yet; waiting for one", scheduler)
        waiting, under_way = iter(tasks), {}

        def submit(count: int) -> list[Any]:
            new = {client.submit(run_task, task, pure=False, retries=0): task for task in islice(waiting, count)}
            under_way.update(new)
            return list(new)

        completed = distributed.as_completed(submit(MOST_SUBMITTED), loop=client.loop)
        for future in completed:
            task = under_way.pop(future)
            yield _outcome(future, task, scheduler)
            future.release()
            completed.update(submit(1))


def _outcome(future: Any, task: BagTask, scheduler: str) -> BagOutcome:
    try:
        outcome: BagOutcome = future.result()
        return outcome
    except Exception as error:  # of Dask: `run_task` raises none
        if future.cancelled() or isinstance(error, OSError):  # withdrawn by nobody; or the connection is lost
            gone = f"{scheduler}: the scheduler has gone; the same command goes on with the rest"
            raise VisualCompassError(gone) from error
        words = " ".join(str(error).split()) or type(error).__name__
        return BagOutcome(task.bag, task.folder, FAILED, f"{task.bag}: {type(error).__name__}: {words}")
