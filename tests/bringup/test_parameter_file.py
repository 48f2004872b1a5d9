"""Parameters of nodes as files: what ROS reads has the value and the type of what was written."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_bringup.graph.launch import parameter_options
from gyrowheel_bringup.graph.nodes import write_parameters
from gyrowheel_core.node import prepare_environment

pytestmark = pytest.mark.graph

TEXTS = (
    "3e32",
    "1e5",
    "1234",
    "0x1f",
    "12_3",
    "nan",
    ".inf",
    "true",
    "null",
    "~",
    "",
    " a: b ",
    "é",
    "'\"\\\n\t",
)
OTHERS = (True, 3, -7, 0.5, 3e32, 1e-7, 0.0)


def _read(arguments: list[str], domain: int) -> dict[str, object]:
    """Return the parameters of a node that is started with some arguments."""
    prepare_environment()  # the first node of a process settles what the middleware reads
    context = Context()
    rclpy.init(
        args=["--ros-args", *arguments],
        context=context,
        domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        node = Node("reader", context=context, automatically_declare_parameters_from_overrides=True)
        read = {name: node.get_parameter(name).value for name in node._parameters if name.startswith("p")}
        node.destroy_node()
    finally:
        context.shutdown()
    return read


def test_every_value_keeps_its_type(tmp_path: Path, domain: int) -> None:
    written = {f"p{k}": value for k, value in enumerate((*TEXTS, *OTHERS))}
    file = tmp_path / "parameters.yaml"
    write_parameters(file, written)
    read = _read(["--params-file", str(file)], domain)
    assert read == written
    assert {name: type(value) for name, value in read.items()} == {
        name: type(value) for name, value in written.items()
    }


def test_texts_that_launch_gives_a_node_stay_texts(domain: int) -> None:
    texts = {f"p{k}": text for k, text in enumerate(TEXTS)}
    options = parameter_options(texts | {"rate": 0.5})
    assert options["parameters"] == [{"rate": 0.5}]
    assert _read(options["ros_arguments"], domain) == texts
