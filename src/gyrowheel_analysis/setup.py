"""For colcon only; pip reads pyproject.toml."""

from glob import glob

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel-analysis",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_analysis", "gyrowheel_analysis.*"]),
    package_data={"": ["py.typed", "**/*.yaml", "**/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_analysis"]),
        ("share/gyrowheel_analysis", ["package.xml"]),
        ("lib/gyrowheel_analysis", sorted(glob("scripts/*"))),
    ],
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
