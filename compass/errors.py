"""Errors a user can cause. Each message gives the value, the limit and the remedy."""


class VisualCompassError(Exception):
    """Base of every error this project raises on purpose; the command line prints it in one line."""


class ConfigError(VisualCompassError, ValueError):
    """A parameter is unknown, of the wrong type or out of its range."""


class ArgumentError(VisualCompassError, TypeError):
    """An argument of another type or unit than is wanted: seconds for nanoseconds, text for a path."""


class ImageError(VisualCompassError, ValueError):
    """An image cannot be used: unknown encoding, wrong shape or type, corrupt data."""
