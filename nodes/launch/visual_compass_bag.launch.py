"""The visual compass on a bag of any format, compressed panoramas republished as raw.

ros2 launch visual_compass visual_compass_bag.launch.py bagfile:=drive.bag gyro_topic:=/imu/data
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from fusion.settings import TopicSettings, load_settings

ROBOT = os.path.join(get_package_share_directory("visual_compass"), "launch", "visual_compass.launch.py")
LAST_WORDS_S = 2.0  # from the last message of the bag to the end of the nodes


def start(context: LaunchContext) -> list:
    """Player, republisher where raw images are wanted, and the end with the end of the bag."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    names = [spec.name for spec in TopicSettings.specs() if spec.name.endswith(("_topic", "_image", "_transport"))]
    topics = load_settings(value("params_file"), {name: value(name) for name in names if value(name)}).topics
    raw = topics.image_transport == "raw"
    awaited = [topics.compass_image, f"{topics.compass_image}/compressed", topics.gyro_topic, topics.odometry_topic]
    player = Node(
        package="visual_compass",
        executable="bag_player",
        output="screen",
        parameters=[
            {
                "bagfile": os.path.abspath(os.path.expanduser(value("bagfile"))),
                "rate": float(value("rate")),
                "start_offset": float(value("start_offset")),
                "loop": value("loop") == "true",
                "wait_for": ",".join(awaited),
            }
        ],
    )
    end = OnProcessExit(
        target_action=player,
        on_exit=[TimerAction(period=LAST_WORDS_S, actions=[EmitEvent(event=Shutdown(reason="the bag has ended"))])],
    )
    republisher = Node(
        package="visual_compass",
        executable="republish_node",
        output="screen",
        parameters=[{"compass_image": topics.compass_image}],
    )
    return [RegisterEventHandler(end), *([republisher] if raw else []), player]


def generate_launch_description() -> LaunchDescription:
    """Arguments, the nodes of the robot, then the player."""
    arguments = [
        DeclareLaunchArgument("bagfile", description="the bag: a .bag, an .mcap, a .db3 or a rosbag2 folder"),
        DeclareLaunchArgument("rate", default_value="1.0", description="seconds of the bag per second"),
        DeclareLaunchArgument("start_offset", default_value="0.0", description="seconds of the bag to skip"),
        DeclareLaunchArgument("loop", default_value="false", choices=["true", "false"], description="play for ever"),
    ]
    robot = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(ROBOT), launch_arguments={"use_sim_time": "true"}.items()
    )
    return LaunchDescription([*arguments, robot, OpaqueFunction(function=start)])
