"""For colcon only; pip reads pyproject.toml, which also holds the metadata."""

from setuptools import find_packages, setup

setup(
    packages=find_packages(include=["gyrowheel_bringup", "gyrowheel_bringup.*"]),
    package_data={"": ["py.typed", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_bringup"]),
        ("share/gyrowheel_bringup", ["package.xml"]),
    ],
)
