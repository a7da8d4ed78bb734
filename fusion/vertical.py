"""The vertical, under its former name; see `fusion.imu.level`."""

from fusion.imu.level import ImuConfig, ImuLevel

__all__ = ["ImuConfig", "ImuLevel"]
