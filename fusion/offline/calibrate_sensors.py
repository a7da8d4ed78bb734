"""What a recording says of the other sensors: noise of the gyro, scale of the tracks, delay of the camera."""

from __future__ import annotations

import math

import numpy as np

from fusion.offline.calibrate_evidence import STILL, Finding
from fusion.offline.open_recording import FileRecording
from fusion.offline.run import FusedRun
from fusion.offline.scores import YawTrack, yaw_at
from fusion.offline.streams import Times
from fusion.offline.summary import KNOWN_DELAY


def gyro_noise(recording: FileRecording) -> Finding:
    """Deviation of the gyro's rate while the tracks stand, its slow bias taken out."""
    name = "fusion.gyro_sigma"
    still = _still_times(recording)
    rates = [recording.gyro.yaw_rate[slice(*np.searchsorted(recording.gyro.t_ns, span))] for span in still]
    steps = np.concatenate([np.diff(rate[np.isfinite(rate)]) for rate in rates] or [np.zeros(0)])
    if steps.size < 50:
        return Finding(name, None, f"{steps.size} gyro samples at standstill; 50 and more are needed")
    sigma = float(np.std(steps) / math.sqrt(2.0))
    if sigma < 1e-6:
        return Finding(name, None, "the rate does not change at standstill: filtered or simulated")
    return Finding(name, float(f"{sigma:.3g}"), f"from {steps.size} samples at standstill")


def _still_times(recording: FileRecording) -> list[tuple[int, int]]:
    """Spans between neighbouring track samples that both stand."""
    odometry = recording.odometry
    standing = (np.abs(odometry.speed) < STILL) & (np.abs(odometry.yaw_rate) < STILL)
    both = np.flatnonzero(standing[1:] & standing[:-1])
    spans: list[tuple[int, int]] = []
    for index in both.tolist():
        start, end = int(odometry.t_ns[index]), int(odometry.t_ns[index + 1])
        if spans and spans[-1][1] == start:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((start, end))
    return spans


def track_scale(recording: FileRecording, fused: YawTrack) -> Finding:
    """Turn the tracks claim over the fused turn, by seconds in which the robot turns."""
    name = "fusion.initial_scale"
    odometry = recording.odometry
    if odometry.t_ns.size < 2:
        return Finding(name, None, "no track odometry")
    seconds: Times = np.arange(odometry.t_ns[0], odometry.t_ns[-1], 2_000_000_000)
    steps = np.diff(odometry.t_ns) * 1e-9 * 0.5 * (odometry.yaw_rate[1:] + odometry.yaw_rate[:-1])
    claimed = YawTrack(odometry.t_ns, np.concatenate([[0.0], np.cumsum(steps)]))
    turns, claims = np.diff(yaw_at(fused, seconds)), np.diff(yaw_at(claimed, seconds))
    turning = np.abs(turns) > math.radians(5.0)
    if np.count_nonzero(turning) < 3:
        return Finding(name, None, "the robot hardly turns")
    scale = float(turns[turning] @ claims[turning] / (turns[turning] @ turns[turning]))
    return Finding(name, round(scale, 3), f"from {np.degrees(np.abs(turns[turning]).sum()):.0f} deg of turning")


def camera_delay(run: FusedRun) -> Finding:
    """By how much later than exposed the images were stamped, as the filter has learnt it."""
    name = "fusion.camera_delay"
    last = next((row.fused for row in reversed(run.rows) if row.fused), None)
    sigma = math.sqrt(last.camera_delay_variance) if last else math.inf
    if last is None or sigma > KNOWN_DELAY:
        return Finding(name, None, "no gyro, or the turn rate hardly changes")
    return Finding(name, round(last.camera_delay, 4), f"from exposure to stamp, s; good to {1e3 * sigma:.1f} ms")
