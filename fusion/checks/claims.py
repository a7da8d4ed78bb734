"""By how much the robot turned in a window as each rate sensor says, and how well it can know."""

from __future__ import annotations

import math

from fusion.checks.stillness import CREEP, CREEP_RATE
from fusion.checks.windows import Claim, Turns
from fusion.config import FusionConfig


def gyro_claim(turns: Turns, start_ns: int, t_ns: int, config: FusionConfig, gyro_noise: float = 1.0) -> Claim | None:
    """By how much the robot turned as the gyro says; None where it did not measure all of it."""
    gyro, known, seconds = turns.gyro, turns.start, (t_ns - start_ns) * 1e-9
    if gyro is None or not gyro.spans(start_ns, t_ns):
        return None
    gain = 1.0 + known.gyro_scale
    turn = (gyro.turn_until(t_ns) - known.bias * seconds) / gain
    noise = config.gyro_sigma * math.sqrt(gyro_noise) * seconds / math.sqrt(gyro.count)
    held = config.rate_walk * ((t_ns - gyro.t_ns) * 1e-9) ** 1.5 / math.sqrt(3.0)  # since its last sample
    noise = math.hypot(noise, known.bias_sigma * seconds, held, math.sqrt(gyro.unseen))
    return Claim(turn, noise, known.gyro_scale_sigma / gain, end=held**2)


def tracks_claim(
    turns: Turns, start_ns: int, t_ns: int, config: FusionConfig, slip_turn: float = 1.0, slip_speed: float = 1.0
) -> Claim | None:
    """By how much the robot turned as the tracks say; None where they did not measure all of it.

    `slip_turn` and `slip_speed`: by what factors they slip more than configured, squared. They are learnt of what is
    believed, and a sensor that errs is believed at first: where they are more than one they do not count.
    """
    tracks, scale, seconds = turns.tracks, turns.start.scale, (t_ns - start_ns) * 1e-9
    if tracks is None or not tracks.spans(start_ns, t_ns):
        return None
    claimed = tracks.turn_until(t_ns)
    if abs(claimed) <= CREEP_RATE * seconds and tracks.distance <= CREEP * seconds:
        return Claim(claimed / scale, CREEP_RATE * seconds, rests=True)
    timing = config.track_timing * (tracks.rate - tracks.start_rate)
    learnt, worst = (
        math.hypot(
            config.track_noise * math.sqrt(seconds * by_speed),
            config.track_slip_turn * math.sqrt(by_turn) * claimed,
            (config.track_slip_speed * math.sqrt(by_speed) + config.veer_sigma) * tracks.distance,
            timing,
        )
        for by_turn, by_speed in ((min(slip_turn, 1.0), min(slip_speed, 1.0)), (1.0, 1.0))
    )
    return Claim(claimed / scale, learnt / scale, turns.start.scale_sigma / scale, worst / scale)
