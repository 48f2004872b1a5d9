"""For colcon only; pip reads pyproject.toml."""

from glob import glob

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel-bringup",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_bringup", "gyrowheel_bringup.*"]),
    package_data={"": ["py.typed", "**/*.yaml", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_bringup"]),
        ("share/gyrowheel_bringup", ["package.xml"]),
        ("share/gyrowheel_bringup/launch", sorted(glob("launch/*.launch.py"))),
        ("share/gyrowheel_bringup/config", sorted(glob("config/*"))),
        ("share/gyrowheel_bringup/urdf", sorted(glob("urdf/*"))),
        ("lib/gyrowheel_bringup", sorted(glob("scripts/*"))),
    ],
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
