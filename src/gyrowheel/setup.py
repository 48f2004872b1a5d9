"""For colcon only; pip reads pyproject.toml."""

from setuptools import find_packages, setup

made = setup(
    name="gyrowheel",
    version="0.1.0",
    packages=find_packages(include=["gyrowheel", "gyrowheel.*"]),
    package_data={"": ["py.typed", "*.pyi", "**/*.yaml", "**/*.xml", "**/*.html", "**/*.css", "**/*.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/gyrowheel"]),
        ("share/gyrowheel", ["package.xml"]),
    ],
    entry_points={"console_scripts": ["gyrowheel = gyrowheel.cli.app:main"]},
)
# colcon evaluates what it finds in the result, and cannot evaluate what setuptools makes of requires-python
if made is not None:  # as where setup is stood in for
    made.python_requires = made.metadata.python_requires = None
