"""What colcon and `ros2` need beside pyproject.toml: marker, package.xml, executables, launch files, config."""

from pathlib import Path
from typing import Any

from setuptools import setup

PACKAGE = "visual_compass"
SHARE = f"share/{PACKAGE}"


def files(pattern: str) -> list[str]:
    """Files of the repository that match a pattern."""
    return sorted(map(str, Path().glob(pattern)))


def from_pyproject() -> dict[str, Any]:
    """What setuptools cannot read itself: ``colcon build --symlink-install`` works in a folder of links, without it."""
    if Path("pyproject.toml").exists():
        return {}
    import tomllib

    content = tomllib.loads((Path(__file__).resolve().parent / "pyproject.toml").read_text(encoding="utf-8"))
    project = content["project"]
    commands = [f"{name} = {function}" for name, function in project["scripts"].items()]
    return {
        "name": project["name"],
        "version": project["version"],
        "py_modules": content["tool"]["setuptools"]["py-modules"],
        "packages": content["tool"]["setuptools"]["packages"],
        "package_data": content["tool"]["setuptools"]["package-data"],
        "entry_points": {"console_scripts": commands},
        "extras_require": project["optional-dependencies"],
    }


setup(
    **from_pyproject(),
    python_requires=">=3.10",
    license="BSD-3-Clause",
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", files("nodes/launch/*.launch.py")),
        (f"{SHARE}/config", files("config/*")),
        # Not console scripts: pip would put them on everybody's PATH; `ros2 run` looks for them here.
        (f"lib/{PACKAGE}", files("nodes/executables/*")),
    ],
)
