"""Warnings: which there are, their order, and that each is told once."""

from pathlib import Path

import pytest

from fusion import Warning
from fusion.checks.warnings import CODES, WarningLog, most_serious_first

STUCK = Warning("gyro_stuck", "gyro", 5, "says 0.1")
LOST = Warning("turn_lost", "compass", 3, "0.4 s without images")


def test_unknown_code_is_refused():
    with pytest.raises(ValueError, match="gyro_broken"):
        Warning("gyro_broken", "gyro", 0, "")


def test_most_serious_comes_first_and_of_one_code_the_earliest():
    earlier = Warning("turn_lost", "compass", 1, "before")
    assert most_serious_first([LOST, earlier, STUCK]) == [STUCK, earlier, LOST]


def test_log_tells_each_once_and_keeps_the_first_time_with_the_latest_words():
    log = WarningLog()
    assert log.note([STUCK]) == [STUCK]
    assert log.note([Warning("gyro_stuck", "gyro", 9, "says 0.2"), LOST]) == [LOST]
    assert log.all() == [Warning("gyro_stuck", "gyro", 5, "says 0.2"), LOST]


def test_docs_explain_every_code_once_in_the_order_of_seriousness():
    lines = (Path(__file__).parents[1] / "docs" / "warnings.md").read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| `")]
    assert [row[0] for row in rows] == [f"`{code}`" for code in CODES]
    assert all(len(row) == 4 and all(row) for row in rows)


def test_sensors_of_a_warning_are_named_one_by_one():
    assert STUCK.sensors == ("gyro",)
    assert Warning("sensors_disagree", "compass+gyro", 0, "").sensors == ("compass", "gyro")
