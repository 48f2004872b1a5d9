"""Parameters of nodes as files: what ROS reads has the value and the type of what was written."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_bringup.graph.parameter_file import write_parameters

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


def test_every_value_keeps_its_type(tmp_path: Path, domain: int) -> None:
    written = {f"p{k}": value for k, value in enumerate((*TEXTS, *OTHERS))}
    file = tmp_path / "parameters.yaml"
    write_parameters(file, written)
    context = Context()
    rclpy.init(
        args=["--ros-args", "--params-file", str(file)],
        context=context,
        domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        node = Node("reader", context=context, automatically_declare_parameters_from_overrides=True)
        read = {name: node.get_parameter(name).value for name in written}
        node.destroy_node()
    finally:
        context.shutdown()
    assert read == written
    assert [type(value) for value in read.values()] == [type(value) for value in written.values()]
