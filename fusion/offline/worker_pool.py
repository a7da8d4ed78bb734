"""Processes that fuse one recording after the other; one that dies takes its recording with it, and nothing else.

The pools of the standard library lose all that is under way when one process is killed, as the kernel does when memory
runs out.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait

from fusion.offline.bag_task import FAILED, BagOutcome, BagTask, run_task
from fusion.offline.compass_process import ONE_THREAD, ended
from fusion.offline.garbage import collect_seldom
from fusion.offline.interruption import Interrupted, interruptible

Part = Callable[[BagTask, float], None]  # takes the finished part of a task, 0..1

_TELL_EVERY_S = 0.2
_END_WITHIN_S = 10.0  # to take away what is half written; then it is killed, and the next run takes it away


def run_in_processes(tasks: Sequence[BagTask], jobs: int, on_part: Part) -> Iterator[BagOutcome]:
    """Outcomes as they come; whatever ends this iteration ends the processes, and they leave nothing half written."""
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")  # inherited
    waiting, workers = deque(tasks), [_Worker() for _ in range(min(jobs, len(tasks)))]
    try:
        while waiting or any(worker.task for worker in workers):
            for worker in workers:
                if worker.task is None and waiting:
                    worker.give(waiting.popleft())
            busy = {worker.connection: worker for worker in workers if worker.task}
            for connection in wait(list(busy)):
                outcome = busy[connection].hear(on_part)  # type: ignore[index]
                if outcome is not None:
                    yield outcome
    finally:
        for worker in workers:
            worker.end()
        for worker in workers:
            worker.wait_for_end()


class _Worker:
    """A process, started when it is first needed and again when it has died."""

    def __init__(self) -> None:
        self.task: BagTask | None = None
        self._start()

    def _start(self) -> None:
        context = get_context("spawn")  # a fork would copy the locks of threads that it does not copy
        self.connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        # Ctrl-C goes to all processes of a terminal; this one decides for all. The child inherits the mask.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        other.close()

    def give(self, task: BagTask) -> None:
        if not self._process.is_alive():
            self._start()
        self.task = task
        with suppress(OSError):  # dead by now: heard at once
            self.connection.send(task)

    def hear(self, on_part: Part) -> BagOutcome | None:
        """Take a message; the outcome, if it is one or the process has died."""
        task = self.task
        assert task is not None
        try:
            message = self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            how = ended(self._process.exitcode, " try fewer --jobs")
            message = BagOutcome(task.bag, task.folder, FAILED, f"{task.bag}: its process {how}")
        if isinstance(message, BagOutcome):
            self.task = None
            return message
        on_part(task, message)
        return None

    def end(self) -> None:
        self._process.terminate()

    def wait_for_end(self) -> None:
        self._process.join(_END_WITHIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.connection.close()


def _serve(connection: Connection) -> None:
    """In the child: take tasks until there are no more, or a signal unwinds all."""
    collect_seldom()
    shown_at = 0.0

    def progress(part: float) -> None:
        nonlocal shown_at
        if time.monotonic() - shown_at > _TELL_EVERY_S:
            shown_at = time.monotonic()
            connection.send(part)  # fails where the parent has gone: then this run ends, too

    try:
        with interruptible(), suppress(EOFError, BrokenPipeError):
            while True:
                connection.send(run_task(connection.recv(), progress))
    except Interrupted:
        sys.exit(1)
