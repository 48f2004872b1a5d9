"""For colcon only; pip reads pyproject.toml."""

from setuptools import find_packages, setup

setup(
    name="gyrowheel-core",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_core", "gyrowheel_core.*"]),
    package_data={"": ["py.typed", "**/*.yaml", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_core"]),
        ("share/gyrowheel_core", ["package.xml"]),
    ],
)
