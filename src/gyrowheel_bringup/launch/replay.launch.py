"""Replay of a recording, with the model of the wheel for viewers.

ros2 launch gyrowheel_bringup replay.launch.py recording:=runs/monday rate:=0.5 rviz:=true estimate:=true
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.viewers import robot_description, rviz_config, viewer_names
from gyrowheel_core import namespaces
from launch import LaunchContext, LaunchDescription

#: Name, default and description of the arguments.
ARGUMENTS = (
    ("recording", None, "Recording to replay"),
    ("rate", "1.0", "Recorded seconds per second; 0: as fast as the subscribers take"),
    ("start", "0.0", "Start [s from the first sample]"),
    ("end", "0.0", "End [s from the first sample]; 0: that of the recording"),
    ("loop", "false", "Start again at the end"),
    ("paused", "false", "Start paused"),
    ("estimate", "false", "Run the drag estimator on it"),
    ("model", "", "Model file that the estimator believes; empty: the default bench without effects"),
    ("namespace", "", "Namespace to publish in, such as /bench2; empty: the root"),
    ("viewable", "true", "Publish the model of the wheel and its frames for viewers"),
    ("rviz", "false", "Start RViz"),
)


def _actions(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    asked = {
        name: given[name].lower() in ("true", "1", "yes")
        for name in ("loop", "paused", "estimate", "viewable", "rviz")
    }
    namespace = namespaces.checked(given["namespace"])
    viewer = {"namespace": namespace, "remappings": viewer_names(namespace)}
    actions = [
        Node(
            package="gyrowheel_analysis",
            executable="replay_node",
            name="replay",
            namespace=namespace,
            parameters=[
                {
                    "directory": ParameterValue(given["recording"], value_type=str),
                    **{name: float(given[name]) for name in ("rate", "start", "end")},
                    **{name: asked[name] for name in ("loop", "paused")},
                    "wait_for_subscribers": int(asked["estimate"]),
                }
            ],
            output="screen",
            on_exit=Shutdown(reason="the replay has ended"),
        )
    ]
    if asked["estimate"]:
        actions.append(
            Node(
                package="gyrowheel_analysis",
                executable="drag_estimator_node",
                name="drag_estimator",
                namespace=namespace,
                parameters=[{"model": ParameterValue(given["model"], value_type=str)}],
                output="screen",
            )
        )
    if asked["viewable"] or asked["rviz"]:
        actions.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[
                    {
                        "robot_description": ParameterValue(robot_description(), value_type=str),
                        "use_sim_time": True,
                    }
                ],
                **viewer,
            )
        )
    if asked["rviz"]:
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(rviz_config())],
                parameters=[{"use_sim_time": True}],
                **viewer,
            )
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, value, text in ARGUMENTS
            ),
            OpaqueFunction(function=_actions),
        ]
    )
