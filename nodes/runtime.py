"""How every node of this package starts, runs and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from compass.errors import VisualCompassError

# A signal that comes between two waits can wake the executor before it invalidates the context, and then never
# again: so no wait is endless.
_LONGEST_WAIT_S = 0.2


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C or SIGTERM; an error of the user's is one line and exit code 1."""
    node: Node | None = None
    rclpy.init(args=args)
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=_LONGEST_WAIT_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except VisualCompassError as error:
        rclpy.logging.get_logger("visual_compass").fatal(str(error))
        return 1
    except Exception:
        if rclpy.ok():
            raise  # else a callback lost its context under its hands: the end was asked for
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
