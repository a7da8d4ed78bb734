"""The version that is installed, as pyproject.toml says it: the one place."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("visual-compass")
except PackageNotFoundError:  # a checkout on PYTHONPATH
    __version__ = "0+unknown"
