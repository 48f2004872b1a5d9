"""Replay of a recording, with the model of the wheel for viewers.

ros2 launch gyrowheel_bringup replay.launch.py recording:=runs/monday rate:=0.5 rviz:=true estimate:=true

Arguments and packages are checked before the first process. The nodes end with the launch, also with one that is
killed.
"""

from __future__ import annotations

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.graph import EXECUTABLES, find_executable
from gyrowheel_bringup.graph.launch import (
    ends_too,
    ends_with_launch,
    flag,
    namespace_of,
    number,
    parameter_options,
    require_known,
    typed,
)
from gyrowheel_bringup.viewers import robot_description, rviz_config, viewer_names
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
REPLAY = ("gyrowheel_recording", "replay_node")
ESTIMATOR = EXECUTABLES["drag_estimator"]
PUBLISHER = ("robot_state_publisher", "robot_state_publisher")
RVIZ = ("rviz2", "rviz2")


def _actions(context: LaunchContext) -> list[Node]:
    require_known(typed(context), [name for name, *_ in ARGUMENTS])
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    asked = {name: flag(name, given[name]) for name in ("loop", "paused", "estimate", "viewable", "rviz")}
    numbers = {name: number(name, given[name]) for name in ("rate", "start", "end")}
    namespace = namespace_of(given["namespace"], context.launch_configurations.get("ros_namespace", ""))
    shown = asked["viewable"] or asked["rviz"]
    wanted = {REPLAY: True, ESTIMATOR: asked["estimate"], PUBLISHER: shown, RVIZ: asked["rviz"]}
    for (package, executable), needed in wanted.items():
        if needed:
            find_executable(package, executable)
    ours = ends_with_launch(namespace)
    viewer = {"namespace": namespace, "remappings": viewer_names(namespace), "prefix": ends_too()}
    actions = [
        Node(
            package=REPLAY[0],
            executable=REPLAY[1],
            name="replay",
            on_exit=Shutdown(reason="the replay has ended"),
            **parameter_options(
                {
                    "directory": given["recording"],
                    **numbers,
                    **{name: asked[name] for name in ("loop", "paused")},
                    "wait_for_subscribers": int(asked["estimate"]),
                }
            ),
            **ours,
        )
    ]
    if asked["estimate"]:
        actions.append(
            Node(
                package=ESTIMATOR[0],
                executable=ESTIMATOR[1],
                name="drag_estimator",
                **parameter_options({"model": given["model"]}),
                **ours,
            )
        )
    if shown:
        actions.append(
            Node(
                package=PUBLISHER[0],
                executable=PUBLISHER[1],
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
                package=RVIZ[0],
                executable=RVIZ[1],
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
