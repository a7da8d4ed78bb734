"""Nodes of ours as separate processes, in a ROS domain of this test run's own."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 300.0  # for anything that a loaded machine does late: no verdict on speed; a healthy one needs a second


def _own_domain() -> tuple[int, Any]:
    """A ROS domain that no other test run on this machine uses, and the lock on it, held while the process lives."""
    for domain in [1 + (os.getpid() + k) % 100 for k in range(100)]:
        lock = (Path(tempfile.gettempdir()) / f"visual-compass-domain-{os.getuid()}-{domain}").open("w")
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return domain, lock
        lock.close()
    raise RuntimeError("all ROS domains from 1 to 100 are in use by other test runs")


# The environment is read when the first context opens: a domain of our own, never beyond this machine.
_DOMAIN, _LOCK = _own_domain()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(_DOMAIN)


class Process:
    """One of our nodes, started as ``python -m module``."""

    def __init__(self, module: str, parameters: Mapping[str, Any], arguments: list[str], log: Path) -> None:
        command = [sys.executable, "-m", module, "--ros-args", *arguments]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
        self.log = log
        environment = dict(os.environ, PYTHONUNBUFFERED="1", PYTHONFAULTHANDLER="1")
        with log.open("wb") as out:
            self._process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=out, stderr=subprocess.STDOUT)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def text(self) -> str:
        """All the node has printed so far."""
        return self.log.read_text(errors="replace")

    def complaints(self) -> list[str]:
        """Lines printed of messages that could not be used (they begin with the topic) and of crashes."""
        ours = ("[INFO]", "[WARN]")
        return [line for line in self.text().splitlines() if "]: /" in line or not line.startswith(ours)]

    def wait(self, timeout: float = PATIENCE_S) -> int:
        return self._process.wait(timeout)

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Send a signal; returns the exit code."""
        self._process.send_signal(how)
        try:
            return self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.send_signal(signal.SIGABRT)  # its fault handler writes where every thread stands
            self._process.wait(PATIENCE_S)
            raise AssertionError(f"{how.name} did not end the node in {PATIENCE_S:g} s:\n{self.text()}") from None

    def close(self) -> None:
        if self.alive:
            self._process.kill()
            self._process.wait(PATIENCE_S)


@contextmanager
def started(module: str, log: Path, arguments: list[str] | None = None, **parameters: Any) -> Iterator[Process]:
    """A running node, gone afterwards; ``__`` in a parameter's name stands for a dot."""
    named = {name.replace("__", "."): value for name, value in parameters.items()}
    process = Process(module, named, arguments or [], log)
    try:
        yield process
    finally:
        process.close()
