"""The bench as `gyrowheel up` starts it, for ros2 launch.

ros2 launch gyrowheel_bringup ground_test.launch.py plan:=quick record:=runs/monday rviz:=true

Everything is checked before the first process: the plan, the packages, and whether the domain has a bench already. The
nodes end with the launch, also with one that is killed.
"""

from __future__ import annotations

import os
import shutil

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.graph import EXECUTABLES, find_executable, node_parameters, require_free
from gyrowheel_bringup.viewers import robot_description, rviz_config, viewer_names
from gyrowheel_control.plans.fitting import plan_for
from gyrowheel_core import namespaces
from gyrowheel_core.node import PARENT_VARIABLE
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario
from launch import LaunchContext, LaunchDescription

#: Name, default and description of the arguments.
ARGUMENTS = (
    ("plan", "", "Test plan to run; empty: none"),
    ("record", "", "New directory to record into; empty: no recording"),
    ("bench", "gyrowheel", "Bench, or its file"),
    ("scenario", "", "File of the true machine; empty: that of the bench file"),
    ("model", "", "Model file that the drag estimator believes; empty: the bench without effects"),
    ("realtime", "false", "Run the bench in wall-clock time"),
    ("namespace", "", "Namespace of the bench, such as /bench2; empty: the root"),
    ("viewable", "true", "Publish the model of the wheel and its frames for viewers"),
    ("rviz", "false", "Start RViz"),
)
PLAN_CLIENT = ("gyrowheel_bringup", "plan_client_node")
PUBLISHER = ("robot_state_publisher", "robot_state_publisher")
RVIZ = ("rviz2", "rviz2")


def _typed(value: object) -> object:
    # launch_ros would parse a text as YAML
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value


def _actions(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    asked = {name: given[name].lower() in ("true", "1", "yes") for name in ("realtime", "viewable", "rviz")}
    bench = Bench.load(given["bench"])
    plan = plan_for(given["plan"], bench) if given["plan"] else None
    machine = Scenario.load(given["scenario"], bench) if given["scenario"] else Scenario()
    viewers = [PUBLISHER] if asked["viewable"] or asked["rviz"] else []
    viewers += [RVIZ] if asked["rviz"] else []
    for package, executable in (*EXECUTABLES.values(), *([PLAN_CLIENT] if plan else []), *viewers):
        find_executable(package, executable)
    namespace = namespaces.checked(given["namespace"])
    require_free(namespace=namespace)
    parameters = node_parameters(
        plan,
        bench=given["bench"],
        scenario=given["scenario"],
        model=given["model"],
        record=given["record"],
        realtime=asked["realtime"],
        machine=machine.identity(bench),
    )
    ours = {
        "output": "screen",
        "additional_env": {PARENT_VARIABLE: str(os.getpid())},
        "namespace": namespace,
    }
    actions = [
        Node(
            package=package,
            executable=executable,
            name=node,
            parameters=[{key: _typed(value) for key, value in parameters[node].items()}],
            on_exit=Shutdown(reason=f"{node} has ended"),
            **ours,
        )
        for node, (package, executable) in EXECUTABLES.items()
    ]
    # programs that are not of this project end with the launch by the kernel's hand, where it can be asked
    ends_too = "setpriv --pdeathsig TERM" if shutil.which("setpriv") else None
    clock = {"use_sim_time": not asked["realtime"]}
    for package, executable in viewers:
        description = {"robot_description": _typed(robot_description())} if executable == PUBLISHER[1] else {}
        actions.append(
            Node(
                package=package,
                executable=executable,
                arguments=["-d", str(rviz_config())] if executable == RVIZ[1] else [],
                parameters=[description | clock],
                prefix=ends_too,
                namespace=namespace,
                remappings=viewer_names(namespace),
            )
        )
    if plan is not None:
        actions.append(
            Node(
                package=PLAN_CLIENT[0],
                executable=PLAN_CLIENT[1],
                name="plan_client",
                parameters=[{"plan": _typed(given["plan"])}],
                on_exit=Shutdown(reason="the plan has ended"),
                **ours,
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
