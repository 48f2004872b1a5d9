"""The bench as `gyrowheel up` starts it, for ros2 launch.

ros2 launch gyrowheel_bringup ground_test.launch.py plan:=quick record:=runs/monday rviz:=true
"""

from __future__ import annotations

import yaml
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.graph import EXECUTABLES, node_parameters
from gyrowheel_bringup.viewers import robot_description, rviz_config
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from launch import LaunchContext, LaunchDescription

ACTION = ("/gyrowheel/run_plan", "gyrowheel_msgs/action/RunPlan")
#: Name, default and description of the arguments.
ARGUMENTS = (
    ("plan", "", "Test plan to run; empty: none"),
    ("record", "", "New directory to record into; empty: no recording"),
    ("bench", "gyrowheel", "Bench, or its file"),
    ("scenario", "", "File of the true machine; empty: that of the bench file"),
    ("model", "", "Model file that the drag estimator believes; empty: the bench without effects"),
    ("realtime", "false", "Run the bench in wall-clock time"),
    ("viewable", "true", "Publish the model of the wheel and its frames for viewers"),
    ("rviz", "false", "Start RViz"),
)


def _typed(value: object) -> object:
    # launch_ros would parse a text as YAML
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value


def _actions(context: LaunchContext) -> list[Node | ExecuteProcess]:
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    asked = {name: given[name].lower() in ("true", "1", "yes") for name in ("realtime", "viewable", "rviz")}
    plan = Plan.load(given["plan"]) if given["plan"] else None
    if plan is not None:
        plan.check(Bench.load(given["bench"]))
    parameters = node_parameters(
        plan,
        bench=given["bench"],
        scenario=given["scenario"],
        model=given["model"],
        record=given["record"],
        realtime=asked["realtime"],
    )
    actions: list[Node | ExecuteProcess] = [
        Node(
            package=package,
            executable=executable,
            name=node,
            parameters=[{key: _typed(value) for key, value in parameters[node].items()}],
            output="screen",
            on_exit=Shutdown(reason=f"{node} has ended"),
        )
        for node, (package, executable) in EXECUTABLES.items()
    ]
    if asked["viewable"] or asked["rviz"]:
        actions.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": _typed(robot_description()), "use_sim_time": True}],
            )
        )
    if asked["rviz"]:
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(rviz_config())],
                parameters=[{"use_sim_time": True}],
            )
        )
    if plan is not None:
        goal = yaml.safe_dump({"plan": plan.to_yaml()})
        actions.append(
            ExecuteProcess(
                cmd=["ros2", "action", "send_goal", "--feedback", *ACTION, goal],
                output="screen",
                on_exit=Shutdown(reason="the plan has ended"),
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
