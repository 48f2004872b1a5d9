"""The bench as `gyrowheel up` starts it, for ros2 launch.

ros2 launch gyrowheel_bringup ground_test.launch.py plan:=quick record:=runs/monday rviz:=true

Everything is checked before the first process: arguments, plan, packages, and whether the domain has a bench already.
The nodes end with the launch, also with one that is killed.
"""

from __future__ import annotations

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gyrowheel_bringup.graph import EXECUTABLES, find_executable, node_parameters, require_free
from gyrowheel_bringup.graph.launch import (
    ends_too,
    ends_with_launch,
    flag,
    namespace_of,
    parameter_options,
    require_known,
    typed,
    without,
)
from gyrowheel_bringup.viewers import robot_description, rviz_config, viewer_names
from gyrowheel_control.loops.supervision import plan_tilt_limit, usual_tilt_limit
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_core.files import require_new
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
    ("without", "", "Nodes that are not started, because your own take their places, separated by commas"),
    ("namespace", "", "Namespace of the bench, such as /bench2; empty: the root"),
    ("viewable", "true", "Publish the model of the wheel and its frames for viewers"),
    ("rviz", "false", "Start RViz"),
)
PLAN_CLIENT = ("gyrowheel_bringup", "plan_client_node")
PUBLISHER = ("robot_state_publisher", "robot_state_publisher")
RVIZ = ("rviz2", "rviz2")


def _actions(context: LaunchContext) -> list[Node]:
    require_known(typed(context), [name for name, *_ in ARGUMENTS])
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    asked = {name: flag(name, given[name]) for name in ("realtime", "viewable", "rviz")}
    namespace = namespace_of(given["namespace"], context.launch_configurations.get("ros_namespace", ""))
    nodes = without("without", given["without"], EXECUTABLES)
    bench = Bench.load(given["bench"])
    plan = plan_for(given["plan"], bench) if given["plan"] else None
    if plan is not None:
        plan_tilt_limit(plan, bench, usual_tilt_limit(bench))
    machine = Scenario.load(given["scenario"], bench) if given["scenario"] else Scenario()
    if given["record"]:
        require_new(Path(given["record"]))
    viewers = [PUBLISHER] if asked["viewable"] or asked["rviz"] else []
    viewers += [RVIZ] if asked["rviz"] else []
    ours = [EXECUTABLES[node] for node in nodes] + ([PLAN_CLIENT] if plan else [])
    for package, executable in (*ours, *viewers):
        find_executable(package, executable)
    require_free(nodes, namespace=namespace)
    parameters = node_parameters(
        plan,
        bench=given["bench"],
        scenario=given["scenario"],
        model=given["model"],
        record=given["record"],
        realtime=asked["realtime"],
        nodes=nodes,
        machine=machine.identity(bench),
    )
    options = ends_with_launch(namespace)
    actions = [
        Node(
            package=package,
            executable=executable,
            name=node,
            on_exit=Shutdown(reason=f"{node} has ended"),
            **parameter_options(parameters[node]),
            **options,
        )
        for node, (package, executable) in EXECUTABLES.items()
        if node in nodes
    ]
    clock = {"use_sim_time": not asked["realtime"]}
    for package, executable in viewers:
        description = {}
        if executable == PUBLISHER[1]:  # as a text, which launch would parse as YAML
            description["robot_description"] = ParameterValue(robot_description(), value_type=str)
        actions.append(
            Node(
                package=package,
                executable=executable,
                arguments=["-d", str(rviz_config())] if executable == RVIZ[1] else [],
                parameters=[description | clock],
                prefix=ends_too(),
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
                on_exit=Shutdown(reason="the plan has ended"),
                **parameter_options({"plan": given["plan"]}),
                **options,
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
