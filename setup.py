"""What colcon and `ros2` need beside pyproject.toml: marker, package.xml, executables, launch files, config."""

from pathlib import Path

from setuptools import setup

PACKAGE = "visual_compass"
SHARE = f"share/{PACKAGE}"


def files(pattern: str) -> list[str]:
    """Files of the repository that match a pattern."""
    return sorted(map(str, Path().glob(pattern)))


setup(
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", files("nodes/launch/*.launch.py")),
        (f"{SHARE}/config", files("config/*")),
        # Not console scripts: pip would put them on everybody's PATH; `ros2 run` looks for them here.
        (f"lib/{PACKAGE}", files("nodes/executables/*")),
    ]
)
