"""The bench as `gyrowheel up` starts it, for those who have ros2 launch.

ros2 launch gyrowheel_bringup ground_test.launch.py plan:=quick record:=runs/monday
"""

from __future__ import annotations

import yaml
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.graph import EXECUTABLES, node_parameters
from gyrowheel_control.plans import Plan
from gyrowheel_sim.bench import Bench
from launch import LaunchContext, LaunchDescription

ACTION = ("/gyrowheel/run_plan", "gyrowheel_msgs/action/RunPlan")


def _typed(value: object) -> object:
    # launch_ros would read a text as YAML
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value


def _actions(context: LaunchContext) -> list[Node | ExecuteProcess]:
    name, bench, record, scenario = (
        LaunchConfiguration(argument).perform(context) for argument in ("plan", "bench", "record", "scenario")
    )
    plan = Plan.load(name) if name else None
    if plan is not None:
        plan.check(Bench.load(bench))
    parameters = node_parameters(plan, bench=bench, scenario=scenario, record=record)
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
            DeclareLaunchArgument("plan", default_value="", description="Test plan to run; empty: none"),
            DeclareLaunchArgument("record", default_value="", description="New directory to record into"),
            DeclareLaunchArgument("bench", default_value="gyrowheel", description="Bench, or its file"),
            DeclareLaunchArgument("scenario", default_value="", description="What the machine really is"),
            OpaqueFunction(function=_actions),
        ]
    )
