"""The visual compass on a bag of any format, compressed panoramas republished as raw.

ros2 launch visual_compass visual_compass_bag.launch.py bagfile:=drive.bag
ros2 launch visual_compass visual_compass_bag.launch.py bagfile:=drive.bag reliable:=true
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    SetLaunchConfiguration,
    TimerAction,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node

from nodes.bag_plan import BagPlan, plan_bag

SHARE = get_package_share_directory("visual_compass")
ROBOT = os.path.join(SHARE, "launch", "visual_compass.launch.py")
PARAMETERS = os.path.join(SHARE, "config", "visual_compass.yaml")
LAST_WORDS_S = 2.0  # from the last message of the bag to the end of the nodes


def nodes_of(plan: BagPlan) -> list:
    """Player, republisher where the panoramas are wanted raw, and the end with the end of the bag."""
    player = Node(
        package="visual_compass",
        executable="bag_player",
        output="screen",
        parameters=[plan.player.to_dict()],
        remappings=plan.remappings,
    )

    def ended(_: object, context: LaunchContext) -> list:
        """Ctrl-C ends the player, too: nobody wants to wait then."""
        last_words = TimerAction(period=LAST_WORDS_S, actions=[EmitEvent(event=Shutdown(reason="the bag has ended"))])
        return [] if context.is_shutdown else [last_words]

    actions = [RegisterEventHandler(OnProcessExit(target_action=player, on_exit=ended)), player]
    if plan.republish:
        images = plan.arguments["compass_image"]
        actions.append(
            Node(
                package="visual_compass",
                executable="republish_node",
                output="screen",
                parameters=[{"compass_image": images}],
            )
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    """Arguments, a look into the bag, the nodes of the robot, then the player."""
    arguments = [
        DeclareLaunchArgument("bagfile", description="the bag: a .bag, an .mcap, a .db3 or a rosbag2 folder"),
        DeclareLaunchArgument("rate", default_value="1.0", description="seconds of the bag per second"),
        DeclareLaunchArgument("start_offset", default_value="0.0", description="seconds of the bag to skip"),
        DeclareLaunchArgument("loop", default_value="false", choices=["true", "false"], description="play for ever"),
    ]
    last: list = []

    def prepare(context: LaunchContext) -> list:
        """All that can fail, before anything runs: an exception later would leave the first nodes running."""
        given = context.launch_configurations
        plan = plan_bag(given, given.get("params_file", PARAMETERS))
        last.extend(nodes_of(plan))
        found = " ".join(f"{name}:={value}" for name, value in plan.arguments.items())
        told = [SetLaunchConfiguration(name, value) for name, value in plan.arguments.items()]
        return [LogInfo(msg=f"from the bag: {found}"), *told]

    robot = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(ROBOT), launch_arguments={"use_sim_time": "true"}.items()
    )
    return LaunchDescription(
        [*arguments, OpaqueFunction(function=prepare), robot, OpaqueFunction(function=lambda context: last)]
    )
