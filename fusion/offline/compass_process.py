"""The compass in a process of its own, some panoramas ahead of the filter: so one run keeps two cores busy.

The panoramas lie in memory that both processes share; stamps go to the one, results come back from it.
"""

from __future__ import annotations

import mmap
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import numpy as np

from compass import CompassConfig, VisualCompassError
from compass.methods.registry import OURS
from compass.tilt import Vector
from fusion.offline.garbage import collect_seldom
from fusion.offline.image_results import ImageResult, Upright, measured_by
from fusion.offline.streams import Frame

WORTH_IT = 200  # panoramas; of fewer a compass here has seen many by the time that another process has started
MOST_AHEAD = 16  # panoramas; so many take 0.1 s, longer than a step of the filter ever does
MOST_BYTES = 64 << 20  # of them; two, however large they are
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
# not multiprocessing's own way, which runs the caller's script again
_START = (
    "import sys; sys.path[:] = sys.argv[3:]; from fusion.offline.compass_process import serve; serve(*sys.argv[1:3])"
)


class CompassProcessError(VisualCompassError, RuntimeError):
    """The process of the compass has died."""


def can_have_process(config: CompassConfig, panoramas: int) -> bool:
    """Whether the compass may have a process of its own, which does not know a user's methods, and that pays."""
    if not (hasattr(os, "memfd_create") and hasattr(os, "sched_getaffinity") and sys.executable):
        return False  # no Linux
    return config.method in OURS and panoramas >= WORTH_IT and len(os.sched_getaffinity(0)) > 1


class CompassProcess(AbstractContextManager["CompassProcess"]):
    """A compass elsewhere, as `measured_by` gives one here; the process ends with the ``with`` statement.

    Parameters
    ----------
    config : CompassConfig
        Of the compass.
    """

    def __init__(self, config: CompassConfig) -> None:
        self._config = config
        self._slot_bytes = self._slots = self._sent = self._received = 0

    def __enter__(self) -> CompassProcess:
        self._memory = os.memfd_create("panoramas")
        self._connection, other = Pipe()
        given = str(other.fileno()), str(self._memory)
        # Ctrl-C goes to all processes of a terminal; this one decides for both. The child inherits the mask.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _START, *given, *map(str, sys.path)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[int(fd) for fd in given],
                env=dict.fromkeys(ONE_THREAD, "1") | os.environ,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        other.close()
        self._tell(self._config)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()  # it holds nothing that has to be put in order
        self._process.wait()
        self._connection.close()
        os.close(self._memory)

    def measure(self, frames: Iterable[Upright]) -> Iterator[ImageResult]:
        """Results of panoramas, of which some are under way.

        Raises
        ------
        CompassProcessError
            The process has died.
        VisualCompassError
            What the compass raised.
        """
        for frame, up in frames:
            larger = frame.image.nbytes > self._slot_bytes
            while self._under_way and (larger or self._under_way == self._slots):
                yield self._receive()
            if larger:
                self._make_slots(frame.image.nbytes)
            self._send(frame, up)
        while self._under_way:
            yield self._receive()

    @property
    def _under_way(self) -> int:
        return self._sent - self._received

    def _make_slots(self, size: int) -> None:
        self._slot_bytes, self._slots = size, min(max(MOST_BYTES // size, 2), MOST_AHEAD)
        os.ftruncate(self._memory, self._slots * size)
        self._shared = mmap.mmap(self._memory, self._slots * size)

    def _send(self, frame: Frame, up: Vector | None) -> None:
        place = self._sent % self._slots * self._slot_bytes
        shape, kind = frame.image.shape, frame.image.dtype.str
        np.copyto(np.ndarray(shape, kind, self._shared, place), frame.image)
        self._tell((frame.t_ns, frame.encoding, up, shape, kind, place))
        self._sent += 1

    def _tell(self, what: object) -> None:
        with suppress(OSError):  # dead by now: heard when a result is asked for
            self._connection.send(what)

    def _receive(self) -> ImageResult:
        try:
            found = self._connection.recv()
        except (EOFError, OSError):
            raise CompassProcessError(f"the compass's process {ended(self._process.wait())}") from None
        self._received += 1
        if isinstance(found, BaseException):
            raise found
        result: ImageResult = found
        return result


def ended(exitcode: int | None, remedy: str = "") -> str:
    """How a process has ended, in words; the `remedy` is for one that is short of memory."""
    if exitcode is not None and exitcode < 0:
        name = signal.Signals(-exitcode).name
        return f"was ended by {name}" + f"; was memory short?{remedy}" * (name == "SIGKILL")
    return f"ended with exit code {exitcode}"


def serve(connection_fd: str, memory_fd: str) -> None:
    """In the child: measure panoramas until the parent has gone."""
    collect_seldom()
    connection, memory = Connection(int(connection_fd)), int(memory_fd)
    with suppress(EOFError, ConnectionError):
        try:
            for result in measured_by(connection.recv())(_shared(connection, memory)):
                connection.send(result)
        except VisualCompassError as error:
            connection.send(error)


def _shared(connection: Connection, memory: int) -> Iterator[Upright]:
    """Panoramas as they lie in the memory that is shared; the compass keeps none of them."""
    pixels: Any = b""
    while True:
        t_ns, encoding, up, shape, kind, place = connection.recv()
        if place + np.dtype(kind).itemsize * np.prod(shape) > len(pixels):
            pixels = mmap.mmap(memory, 0, prot=mmap.PROT_READ)
        yield Frame(t_ns, np.ndarray(shape, kind, pixels, place), encoding), up
