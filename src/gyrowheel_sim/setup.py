"""For colcon only; pip reads pyproject.toml."""

from glob import glob

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel-sim",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_sim", "gyrowheel_sim.*"]),
    package_data={"": ["py.typed", "**/*.json", "**/*.npz", "**/*.yaml", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_sim"]),
        ("share/gyrowheel_sim", ["package.xml"]),
        ("lib/gyrowheel_sim", sorted(glob("scripts/*"))),
    ],
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
