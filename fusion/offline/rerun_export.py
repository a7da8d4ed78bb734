"""A run for the Rerun viewer: yaws, sigmas, innovations, panoramas and warnings at their stamps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compass.errors import VisualCompassError
from fusion.offline.curves import aligned_yaws, innovations
from fusion.offline.report.thumbnails import Thumbnails
from fusion.offline.run import FusedRun

FILE = "run.rrd"


def check_rerun() -> Any:
    """The library; `VisualCompassError` where it is not installed."""
    try:
        import rerun
    except ImportError:
        raise VisualCompassError(
            "--rerun needs the Rerun SDK, which is not installed: pip install 'visual-compass[rerun]'"
        ) from None
    return rerun


def write_rerun(path: Path, run: FusedRun, pictures: Thumbnails) -> None:
    """Write a run as a recording that ``rerun FILE`` opens; yaws and sigmas in deg."""
    rr = check_rerun()
    stream = rr.RecordingStream("visual_compass")
    stream.save(str(path))

    def send(name: str, t_ns: Any, columns: Any) -> None:
        stamps = np.asarray(t_ns, np.int64).astype("datetime64[ns]")
        stream.send_columns(
            rr.new_entity_path(name.split("/")), indexes=[rr.TimeColumn("stamp", timestamp=stamps)], columns=columns
        )

    for name, track in aligned_yaws(run).items():
        send(f"yaw_deg/{name}", track.t_ns, rr.Scalars.columns(scalars=np.degrees(track.yaw)))
        if track.sigma is not None:
            send(f"sigma_deg/{name}", track.t_ns, rr.Scalars.columns(scalars=np.degrees(track.sigma)))
    if run.truth is not None:
        truth = np.degrees(run.truth.yaw - run.truth.yaw[0])
        send("yaw_deg/truth", run.truth.t_ns, rr.Scalars.columns(scalars=truth))
    for sensor, (t_ns, values) in innovations(run).items():
        send(f"innovation_sigma/{sensor.value}", t_ns, rr.Scalars.columns(scalars=values))
    if pictures.pictures:
        times, jpegs = zip(*pictures.pictures, strict=True)
        kinds = ["image/jpeg"] * len(jpegs)
        send("panorama", times, rr.EncodedImage.columns(blob=list(jpegs), media_type=kinds))
    for one in run.warnings:
        text = [one.warning.text] * len(one.spans)
        send(f"warnings/{one.warning.code}", [since for since, _ in one.spans], rr.TextLog.columns(text=text))
    stream.disconnect()
