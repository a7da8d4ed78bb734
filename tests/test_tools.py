"""The tools that print tables and draw pictures start, and say how they are called."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
NAMES = [f"tools.{file.stem}" for file in sorted((TESTS / "tools").glob("*.py")) if file.stem != "__init__"]


@pytest.mark.parametrize("name", [*NAMES, "mutants"])
def test_tool_says_how_it_is_called(name):
    paths = os.pathsep.join([str(TESTS.parent), str(TESTS)])
    result = subprocess.run(
        [sys.executable, "-m", name, "--help"],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert f"PYTHONPATH=tests python -m {name}" in result.stdout
