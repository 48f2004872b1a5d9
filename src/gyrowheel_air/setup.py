"""For colcon only; pip reads pyproject.toml."""

from setuptools import find_packages, setup

setup(
    name="gyrowheel-air",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_air", "gyrowheel_air.*"]),
    package_data={"": ["py.typed", "**/*.json", "**/*.npz", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_air"]),
        ("share/gyrowheel_air", ["package.xml"]),
    ],
)
