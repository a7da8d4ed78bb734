"""How every node of this package starts, runs and ends."""

from __future__ import annotations

import gc
import logging
import re
import signal
from collections.abc import Callable, Sequence

import rclpy
from rclpy.clock import JumpHandle, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from compass.errors import VisualCompassError

_BACK = Duration(seconds=-0.1)  # a clock that goes back by less is handled as late data
# A signal that comes between two waits can wake the executor before it invalidates the context, and then never
# again: so no wait is endless.
_LONGEST_WAIT_S = 0.2


class FinishedError(Exception):
    """Raised in a callback of a node whose work is done."""


class RosLogHandler(logging.Handler):
    """Hands what the pipeline logs to the node's logger, and thus to ``/rosout``."""

    def __init__(self, logger: RcutilsLogger) -> None:
        super().__init__(logging.WARNING)
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Log a record; rclpy wants one severity a source line."""
        if record.levelno >= logging.ERROR:
            self._logger.error(self.format(record))
        else:
            self._logger.warning(self.format(record))


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C or SIGTERM; an error of the user's is one line and exit code 1."""
    node: Node | None = None
    log = rclpy.logging.get_logger("visual_compass")
    try:
        rclpy.init(args=None if args is None else list(args))
    except RuntimeError as error:  # rcl's: a parameter file or remapping it cannot parse
        log.fatal(one_line(error))
        return 1
    try:
        executor = SingleThreadedExecutor()
        node = make_node()
        logging.getLogger().addHandler(RosLogHandler(node.get_logger()))
        gc.collect()
        gc.freeze()  # a full collection over all the modules' objects would hold every thread for two frames' time
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=_LONGEST_WAIT_S)
    except (KeyboardInterrupt, ExternalShutdownException, FinishedError):
        pass
    except (VisualCompassError, NameValidationException) as error:
        log.fatal(one_line(error))
        return 1
    except Exception:
        if rclpy.ok():
            raise  # else a callback lost its context under its hands: the end was asked for
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # launch and terminal both send one; the first is enough
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def one_line(error: Exception) -> str:
    """An error in one line, without the places in rcl's source that it passed through."""
    return re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))


def on_jump_back(node: Node, reset: Callable[[], None]) -> JumpHandle:
    """Call `reset` when the node's clock jumps back, as with ``use_sim_time`` and a bag played again."""

    def jumped(jump: TimeJump) -> None:
        node.get_logger().warning(f"time jumped by {jump.delta.nanoseconds * 1e-9:.3f} s: starting anew")
        reset()

    threshold = JumpThreshold(min_forward=None, min_backward=_BACK, on_clock_change=False)
    return node.get_clock().create_jump_callback(threshold, post_callback=jumped)
