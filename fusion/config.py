"""What can be set about the filter."""

from dataclasses import dataclass

from compass.parameters import ParameterSet, parameter


@dataclass(frozen=True)
class FusionConfig(ParameterSet):
    """Settings of `YawFusion`; every field has a default, an unusable value raises `ConfigError`."""

    lag_window: float = parameter(
        1.0, "how late a sample may come and still be applied at its own time", unit="s", low=0.0, high=60.0
    )
