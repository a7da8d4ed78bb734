"""The visual compass on the robot.

ros2 launch visual_compass visual_compass.launch.py compass_image:=/camera/pano image_transport:=compressed
ros2 launch visual_compass visual_compass.launch.py namespace:=robot1 gyro_topic:=none
"""

import os

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = get_package_share_directory("visual_compass")
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"

# Launch arguments that set a parameter of the same name.
PARAMETERS = {
    "compass_image": "topic of the panoramas, none: no camera",
    "image_transport": "raw, compressed, ffmpeg or foxglove",
    "compass_output_topic": "topic of the raw compass",
    "compass_textout": "true: print the current angle",
    "gyro_topic": "topic of the gyro, none: no gyro",
    "odometry_topic": "topic of the track odometry, none: no odometry",
    "fused_output_topic": "topic of the fused yaw",
    "odom_frame": "frame_id of the outputs",
    "base_frame": "child_frame_id of the outputs",
    "position": "dead_reckoning, or none: x and y are zero",
    "publish_tf": "true: broadcast odom_frame -> base_frame",
    "invert_tf": "true: broadcast base_frame -> odom_frame instead",
    "reliable": "true: take every image in its turn, for a bag",
    "use_sim_time": "true: time comes from /clock",
}


def start(context: LaunchContext) -> list:
    """The node with the parameter file and whatever launch arguments were given."""

    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    if not os.path.isfile(value("params_file")):  # else the node would run with the defaults
        raise FileNotFoundError(f"params_file: {value('params_file')} does not exist; give the path of a YAML file")
    given = {name: yaml.safe_load(value(name)) for name in PARAMETERS if value(name)}
    actions = []
    if PROFILE not in os.environ:
        actions.append(SetEnvironmentVariable(PROFILE, os.path.join(SHARE, "config", "fastdds.xml")))
    node = Node(
        package="visual_compass",
        executable=value("node"),
        name=value("name") or value("node"),
        namespace=value("namespace"),
        output="screen",
        parameters=[value("params_file"), given],
    )
    return [*actions, node]


def generate_launch_description() -> LaunchDescription:
    """Arguments, then the node."""
    own = [
        DeclareLaunchArgument(
            "node", default_value="fusion_node", choices=["fusion_node", "compass_node"], description="which node"
        ),
        DeclareLaunchArgument(
            "namespace", default_value="", description="of the node; relative topics move with it, empty: none"
        ),
        DeclareLaunchArgument("name", default_value="", description="of the node; empty: that of its executable"),
        DeclareLaunchArgument(
            "params_file",
            default_value=os.path.join(SHARE, "config", "visual_compass.yaml"),
            description="parameter file; defaults < this file < launch arguments",
        ),
    ]
    passed = [
        DeclareLaunchArgument(name, default_value="", description=f"{what}; empty: as in params_file")
        for name, what in PARAMETERS.items()
    ]
    return LaunchDescription([*own, *passed, OpaqueFunction(function=start)])
