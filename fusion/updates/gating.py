"""Every measurement passes its sensor's gate, and corrects the state if it is accepted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scipy.special import chdtri

from fusion.buffer.events import FOREVER_NS, Sensor
from fusion.checks.gate import Verdict
from fusion.config import FusionConfig
from fusion.state.ekf import Expectation, Measurement

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState


class Gating:
    """The gates of all sensors.

    Attributes
    ----------
    limit : float
        Largest normalised innovation squared that passes.
    """

    def __init__(self, config: FusionConfig) -> None:
        self.limit = gate_limit(config)
        seconds = dict.fromkeys(Sensor, config.recovery_time) | {Sensor.TRACKS: config.slip_recovery_time}
        self._recovery_ns = {sensor: round(time * 1e9) for sensor, time in seconds.items()}

    def judge(self, state: FilterState, sensor: Sensor, measurement: Measurement, expected: Expectation) -> Verdict:
        """Pass a measurement, of which the state `expected` that, through its gate and fuse it if accepted."""
        limit, recovery_ns = self.limit, self._recovery_ns[sensor]
        if state.isolation.excludes(sensor) or (sensor is Sensor.TRACKS and state.isolation.alternative(sensor)):
            limit, recovery_ns = -1.0, FOREVER_NS
        gate = state.gates[sensor].judge(state.t_ns or 0, measurement.innovation, expected.S, limit, recovery_ns)
        state.gates = {**state.gates, sensor: gate}
        verdict = gate.report.verdict if gate.report else Verdict.REJECTED
        if verdict is Verdict.ACCEPTED:
            state.ekf.correct(measurement, expected)
        return verdict

    @staticmethod
    def refuse(state: FilterState, sensor: Sensor, measurement: Measurement) -> None:
        """Count a measurement as one that its gate refuses, whatever it says."""
        gate, S = state.gates[sensor], state.ekf.expect(measurement).S
        gate = gate.judge(state.t_ns or 0, measurement.innovation, S, -1.0, FOREVER_NS)
        state.gates = {**state.gates, sensor: gate}


def gate_limit(config: FusionConfig) -> float:
    """Largest normalised innovation squared to let pass (chi-square of one degree of freedom).

    Bar-Shalom, Li & Kirubarajan 2001, doi:10.1002/0471221279, section 5.4.
    """
    return float(chdtri(1, 1.0 - config.gate_probability))
