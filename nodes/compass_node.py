"""The compass alone, for people who fuse elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence

from rclpy.node import Node
from std_srvs.srv import Empty

from compass import VisualCompass
from compass.errors import ConfigError
from fusion import Warning
from fusion.checks.images import image_warnings
from fusion.checks.warnings import most_serious_first
from fusion.settings import absent
from nodes.compass_stream import CompassStream
from nodes.diagnostics import Diagnostics, Finding, warned
from nodes.names import check_names
from nodes.parameters import NodeParameters
from nodes.runtime import on_jump_back, run
from nodes.throttled_log import ThrottledLog, WarningLogger


class CompassNode(Node):
    """Publishes the raw compass as ``nav_msgs/Odometry``.

    Attributes
    ----------
    warning_sources : list of callable
        What says what is wrong with the images at present, as in `YawPipeline`.
    """

    def __init__(self) -> None:
        super().__init__("compass_node", automatically_declare_parameters_from_overrides=True)
        parameters = NodeParameters(self, ("topics", "compass"))
        settings = parameters.settings
        check_names(self, settings.topics)
        if absent(settings.topics.compass_image):
            raise ConfigError(
                "compass_image: none, and a compass_node has nothing else; give the topic of the panoramas"
            )
        log = ThrottledLog(self.get_logger().warning)
        compass = VisualCompass(settings.compass)
        self.warning_sources: list[Callable[[], Iterable[Warning]]] = [lambda: image_warnings(compass)]
        self._tell = WarningLogger(self.get_logger().warning)
        self._stream = CompassStream(self, settings, compass, log)
        parameters.on_change(self._stream.apply)
        self.create_service(Empty, "~/reset", self._on_reset)
        self._jumps = on_jump_back(self, self._stream.reset)
        self.get_logger().info(f"compass {self._stream.topic} -> {self._stream.output}")
        self._diagnostics = Diagnostics(self, {"images": self._finding})

    def _finding(self) -> Finding:
        warnings = most_serious_first(warning for source in self.warning_sources for warning in source())
        self._tell(warnings)
        return warned(self._stream.finding(), warnings)

    def _on_reset(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        self._stream.reset()
        return response

    def destroy_node(self) -> None:
        """End the image thread, then the node."""
        self._stream.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``ros2 run visual_compass compass_node``."""
    return run(CompassNode, args)


if __name__ == "__main__":
    sys.exit(main())
