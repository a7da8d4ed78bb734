"""Another package with the name of one of ours is named in a line, by the command and by the nodes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STARTS = {
    "command": ["-c", "import sys, visual_compass; sys.exit(visual_compass.main())", "--version"],
    "module": ["-m", "nodes.fusion_node"],
    **{file.name: [str(file)] for file in sorted((ROOT / "nodes" / "executables").iterdir()) if file.is_file()},
}


def start(arguments: list[str], *path: Path) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(map(str, path)))
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False, cwd=ROOT / "docs"
    )


@pytest.mark.parametrize("what", STARTS)
@pytest.mark.parametrize("content", ["", "raise RuntimeError('no such device')"], ids=["empty", "raises"])
def test_foreign_package_is_named_in_a_line(what, content, tmp_path):
    (tmp_path / "fusion").mkdir()
    (tmp_path / "fusion" / "__init__.py").write_text(content)
    done = start(STARTS[what], tmp_path, ROOT)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert f"the package 'fusion' in {tmp_path}/fusion/__init__.py is another one of that name" in done.stderr


def test_foreign_package_that_pip_installed_is_named_with_its_distribution(tmp_path):
    (tmp_path / "compass").mkdir()
    (tmp_path / "compass" / "__init__.py").write_text("")
    info = tmp_path / "compass_of_others-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: compass-of-others\nVersion: 1.0\n")
    (info / "top_level.txt").write_text("compass\n")
    done = start(STARTS["command"], tmp_path, ROOT)
    assert done.returncode == 1
    assert "pip uninstall compass-of-others, then install visual-compass again" in done.stderr


def test_own_packages_are_let_pass():
    done = start(STARTS["command"], ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert "version" in done.stdout
