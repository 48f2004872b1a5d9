"""For colcon only; pip reads pyproject.toml."""

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel-air",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel_air", "gyrowheel_air.*"]),
    package_data={"": ["py.typed", "**/*.json", "**/*.npz", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel_air"]),
        ("share/gyrowheel_air", ["package.xml"]),
    ],
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
