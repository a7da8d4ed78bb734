"""What the gyro's scale makes of a turn that nobody else has measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fusion.state.ekf import IDENTITY, State

if TYPE_CHECKING:
    from fusion.state.filter_state import FilterState


def tie_to_scale(state: FilterState) -> None:
    """Tie all yaws since it was last measured to the gyro's scale: they are turned too far, or too little, together.

    Increments and tracks measure turns between them, and so tell nothing of that, unless they tell the scale.
    """
    ekf, since_ns = state.ekf, state.aided_ns
    times = {State.CLONE + i: one.t_ns for i, one in enumerate(state.clones) if one and one.placed_ns == one.t_ns}
    if state.tracks is not None:
        times[State.TRACK_REF] = state.tracks.reference.t_ns
    if state.stillness.reference_ns is not None:
        times[State.STILL_REF] = state.stillness.reference_ns
    yaws = [one for one, t_ns in times.items() if since_ns is None or t_ns > since_ns]
    T, x = IDENTITY.copy(), ekf.x
    for one in (State.YAW, *yaws):
        T[one, State.GYRO_SCALE] = -(float(x[one]) - state.aided_yaw) / (1.0 + float(x[State.GYRO_SCALE]))
    ekf.transform(T)
    ekf.x = x
    state.aided_yaw, state.aided_ns = float(x[State.YAW]), state.t_ns
