"""Gyro, track odometry and truth from CSV files, by the names of their columns."""

from __future__ import annotations

import csv
import math
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from compass.errors import VisualCompassError
from fusion.checks.warnings import WarningLog
from fusion.imu.levelling import ImuLevel
from fusion.offline.columns import levelled
from fusion.offline.sensor_columns import GYRO_COLUMNS, ODOMETRY_COLUMNS, TRUTH_COLUMNS
from fusion.offline.streams import Floats, GyroTrack, OdometryTrack, Times, TruthTrack, unwrap
from fusion.samples import GyroSample

TIME_COLUMNS = ("t_ns", "t")  # the first one that is there is taken
RATES, FORCES = ("gx", "gy", "gz"), ("ax", "ay", "az")
LAST_NS = 2**63 - 1  # that can be written
SHOWN = 60  # characters of a row that cannot be used


class SensorFileError(VisualCompassError):
    """A file of samples that cannot be used."""


def read_gyro(path: Path, level: ImuLevel, log: WarningLog, dropped: Counter[str]) -> GyroTrack:
    """Turn rates about the vertical.

    Parameters
    ----------
    path : Path
        CSV file with the columns `GYRO_COLUMNS`.
    level : ImuLevel
        Finds the vertical where all three axes are given.
    log : WarningLog
        Takes what is wrong with the IMU.
    dropped : Counter of str
        Takes rows that cannot be used, by reason.

    Raises
    ------
    SensorFileError
        The file cannot be read, a column is missing, or no row can be used.
    """
    header = header_of(path)
    if "yaw_rate" in header:
        t_ns, values = numbers(path, ("yaw_rate",), (), GYRO_COLUMNS, dropped)
        return GyroTrack.of(GyroSample(t, rate) for t, rate in zip(t_ns.tolist(), values[:, 0].tolist(), strict=True))
    forces = FORCES if set(FORCES) <= set(header) else ()
    t_ns, values = numbers(path, RATES, forces, GYRO_COLUMNS, dropped)
    unknown = np.full((len(t_ns), 10 - values.shape[1]), math.nan)
    return GyroTrack.of(levelled((t_ns, np.hstack([values, unknown])), level, log))


def read_odometry(path: Path, dropped: Counter[str]) -> OdometryTrack:
    """What the tracks claim; a rate that is not given is that of the yaw.

    Raises
    ------
    SensorFileError
        The file cannot be read, a column is missing, or no row can be used.
    """
    header = header_of(path)
    turns = [name for name in ("yaw_rate", "yaw") if name in header] or ["yaw_rate"]
    optional = ("speed",) if "speed" in header else ()
    t_ns, values = numbers(path, turns, optional, ODOMETRY_COLUMNS, dropped)
    column = dict(zip((*turns, *optional), values.T, strict=True))
    nothing = np.full(len(t_ns), math.nan)
    yaw = column.get("yaw", nothing)
    rate = column["yaw_rate"] if "yaw_rate" in column else _rate_of(t_ns, yaw)
    speed = np.nan_to_num(column["speed"]) if "speed" in column else np.zeros(len(t_ns))
    return OdometryTrack(t_ns, rate, speed, yaw)


def read_truth(path: Path, dropped: Counter[str]) -> TruthTrack:
    """The true yaw; `SensorFileError` where the file cannot be used."""
    t_ns, values = numbers(path, ("yaw",), (), TRUTH_COLUMNS, dropped)
    return TruthTrack(t_ns, unwrap(values[:, 0]))


def _rate_of(t_ns: Times, yaw: Floats) -> Floats:
    """Turn rate of a yaw by backward differences, as the odometry's model takes it from poses."""
    steps = np.diff(t_ns) * 1e-9
    turns = np.diff(unwrap(yaw))
    rates = np.divide(turns, steps, out=np.zeros_like(turns), where=steps > 0.0)
    return np.concatenate([rates[:1], rates]) if rates.size else np.zeros(len(t_ns))


def header_of(path: Path) -> list[str]:
    """Names of a CSV file's columns."""
    return next(csv_rows(path), [])


def numbers(
    path: Path, wanted: Sequence[str], optional: Sequence[str], help_text: str, dropped: Counter[str]
) -> tuple[Times, Floats]:
    """Stamps (N,) in ns, sorted, and values (N, K) of the wanted and then the optional columns.

    A row counts where its stamp and all wanted values are finite numbers; of the optional ones, NaN stands for what is
    none.

    Raises
    ------
    SensorFileError
        The file cannot be read, a column is missing, or no row can be used.
    """
    rows = csv_rows(path)
    header = next(rows, [])
    clock = next((name for name in TIME_COLUMNS if name in header), None)
    if clock is None or not set(wanted) <= set(header):
        raise SensorFileError(f"{path}: its columns are {', '.join(header[:20]) or 'none'}; wanted {help_text}")
    places = [header.index(name) for name in (*wanted, *optional)]
    times: list[int] = []
    values: list[list[float]] = []
    fault, unusable = "has no rows", list[str]()
    for row in rows:
        try:
            check_length(row, header)
            t_ns = nanoseconds(row[header.index(clock)], clock)
            value = [_number(row[place]) for place in places]
            none = [name for name, one in zip(wanted, value, strict=False) if not math.isfinite(one)]
            if none:
                raise ValueError(f"no number in {', '.join(none)}")
        except (ValueError, IndexError) as error:
            fault, unusable = str(error) if isinstance(error, ValueError) else "row too short", row
            dropped[f"{path.name}: {fault}"] += 1
            continue
        times.append(t_ns)
        values.append(value)
    if not times:
        said = f" ({quoted(unusable)})" if unusable else ""
        raise SensorFileError(f"{path}: no row can be used: {fault}{said}; wanted {help_text}")
    t, table = np.array(times, np.int64), np.array(values, np.float64)
    order = np.argsort(t, kind="stable")
    return t[order], table[order]


def check_length(row: Sequence[str], header: Sequence[str]) -> None:
    """Refuse a row of more cells than columns: its cells are not those of the columns, as with decimal commas.

    Raises
    ------
    ValueError
        A cell beyond the columns is not empty.
    """
    if any(cell.strip() for cell in row[len(header) :]):
        raise ValueError("more cells than columns; decimals are set off by points")


def quoted(row: Sequence[str]) -> str:
    """A row of a file as it is named in an error: its beginning."""
    return ascii(" | ".join(row)[:SHOWN])


def nanoseconds(text: str, column: str = "t") -> int:
    """A stamp as exact nanoseconds: seconds in a column ``t``, nanoseconds in ``t_ns``.

    Raises
    ------
    ValueError
        It is no finite number, negative, or beyond what can be written.
    """
    try:
        t_ns = int(Decimal(text.strip()) * (1 if column == "t_ns" else 1_000_000_000))
    except (InvalidOperation, ValueError, OverflowError):
        raise ValueError(f"no number in {column}") from None
    if not 0 <= t_ns <= LAST_NS:
        raise ValueError(f"{column} is negative or too large")
    return t_ns


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def csv_rows(path: Path) -> Iterator[list[str]]:
    """The lines of a CSV file, that of the column names first; commas, semicolons or tabs stand between the cells.

    Raises
    ------
    SensorFileError
        The file cannot be read, or is no text.
    """
    if not os.path.isfile(path):
        fault = "no regular file" if os.path.exists(path) else "no such file"
        raise SensorFileError(f"{path}: {fault}; give a CSV file")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            separator = max(",;\t", key=file.readline(100_000).count)
            file.seek(0)
            rows = csv.reader(file, delimiter=separator)
            yield [cell.strip().lower() for cell in next(rows, [])]
            yield from (row for row in rows if row)
    except OSError as error:
        raise SensorFileError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error):
        raise SensorFileError(f"{path}: no CSV text; give a file with a line of column names") from None
