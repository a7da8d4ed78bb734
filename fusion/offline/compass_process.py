"""The compass of one recording in a process of its own, while this one filters: two cores work where one did."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Generator
from multiprocessing.connection import Connection

import cv2

from compass.errors import VisualCompassError
from compass.methods.registry import OURS
from fusion.offline.image_results import ImageResult, measure_images
from fusion.offline.streams import Recording, SeparableRecording
from fusion.settings import Settings


class ProcessError(VisualCompassError):
    """The compass's process ended before its work was done."""


def measure_beside(recording: Recording, settings: Settings) -> Generator[ImageResult, None, None]:
    """As `measure_images`, in a process of its own where that is safe and of use; the results are the same.

    Raises
    ------
    ProcessError
        The process was killed, or died of an error that it has printed.
    VisualCompassError
        Whatever `measure_images` raises.
    """
    of_use = recording.frame_count > 0 and _can_fork(settings)
    if of_use and isinstance(recording, SeparableRecording) and recording.is_separable:
        return _measure_beside(recording, settings)
    return measure_images(recording, settings)


def _can_fork(settings: Settings) -> bool:
    """Whether there is a second core, this is no worker among many, and no thread is left behind by a fork.

    OpenCV's threads are: `visual-compass` tells it to have one. A method of the user's may have threads, too.
    """
    return (
        sys.platform == "linux"
        and len(os.sched_getaffinity(0)) > 1
        and multiprocessing.parent_process() is None
        and threading.active_count() == 1
        and cv2.getNumThreads() == 1
        and settings.compass.method in OURS
    )


def _measure_beside(recording: SeparableRecording, settings: Settings) -> Generator[ImageResult, None, None]:
    context = multiprocessing.get_context("fork")  # the bag is open and its small samples are read
    here, there = context.Pipe(duplex=False)  # a full pipe lets the compass wait: memory is bounded
    process = context.Process(target=_work, args=(recording, settings, here, there), name="compass", daemon=True)
    process.start()
    there.close()
    try:
        while True:
            try:
                got = here.recv()  # an ImageResult, an error, or at the end what was found
            except EOFError:
                process.join()
                code = process.exitcode or 0
                how = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
                raise ProcessError(f"the compass's process {how} in mid work; is there enough memory?") from None
            if not isinstance(got, ImageResult):
                break
            yield got
        if isinstance(got, VisualCompassError):
            raise got
        recording.take_findings(got)
    finally:
        here.close()
        process.terminate()
        process.join()


def _work(recording: SeparableRecording, settings: Settings, parent: Connection, there: Connection) -> None:
    """What the other process does."""
    parent.close()  # so that writing fails once the parent is gone
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which a terminal sends to both; the parent ends this one
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        try:
            for result in measure_images(recording, settings):
                there.send(result)
        except VisualCompassError as error:
            there.send(error)
        else:
            there.send(recording.findings)
    except BrokenPipeError:
        pass  # nobody waits for more
