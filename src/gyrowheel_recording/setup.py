"""For colcon only; pip reads pyproject.toml."""

from glob import glob

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel-recording",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_recording", "gyrowheel_recording.*"]),
    package_data={"": ["py.typed", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_recording"]),
        ("share/gyrowheel_recording", ["package.xml"]),
        ("lib/gyrowheel_recording", sorted(glob("scripts/*"))),
    ],
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
