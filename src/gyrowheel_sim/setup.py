"""For colcon only; pip reads pyproject.toml, which also holds the metadata."""

from glob import glob

from setuptools import find_packages, setup

setup(
    packages=find_packages(include=["gyrowheel_sim", "gyrowheel_sim.*"]),
    package_data={"": ["py.typed", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_sim"]),
        ("share/gyrowheel_sim", ["package.xml"]),
        ("lib/gyrowheel_sim", sorted(glob("scripts/*"))),
    ],
)
