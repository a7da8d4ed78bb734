"""The compass alone, for people who fuse elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rclpy.node import Node

from compass import VisualCompass
from fusion.settings import Settings
from nodes.compass_stream import CompassStream
from nodes.complaints import Complaints
from nodes.parameters import NodeParameters
from nodes.runtime import run


class CompassNode(Node):
    """Publishes the raw compass as ``nav_msgs/Odometry``."""

    def __init__(self) -> None:
        super().__init__("compass_node", automatically_declare_parameters_from_overrides=True)
        parameters = NodeParameters(self, ("topics", "compass"))
        self._complaints = Complaints(self.get_logger().warning)
        self._compass = VisualCompass(parameters.settings.compass)
        self._stream = CompassStream(self, parameters.settings, self._compass, self._complaints)
        parameters.on_change(self._apply)

    def _apply(self, settings: Settings) -> None:
        self._compass.config = settings.compass
        self._stream.textout = settings.topics.compass_textout

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        self._stream.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass compass_node``."""
    return run(CompassNode, args)


if __name__ == "__main__":
    sys.exit(main())
