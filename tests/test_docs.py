"""The documentation: examples run, links lead somewhere, and the README stays short."""

import math
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from tiny_bags import TinyDrive

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "compass/**/*.md", "fusion/**/*.md", "nodes/**/*.md")
    for path in ROOT.glob(pattern)
)


def run_example(name, *arguments):
    """Output of an example, as a reader would start it from the root of the repository."""
    environment = dict(os.environ, MPLBACKEND="Agg")
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, f"docs/examples/{name}", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_example_of_a_folder_plots_the_turn(tmp_path):
    drive, folder = TinyDrive(width=512), tmp_path / "panoramas"
    folder.mkdir()
    times = drive.times(10.0)
    for index, t in enumerate(times):
        cv2.imwrite(str(folder / f"{index:04d}.png"), drive.panorama(t))
    text = run_example("folder_to_plot.py", folder, 10, tmp_path / "yaw.png")
    turned = float(re.search(r"turned by (-?[\d.]+) deg", text).group(1))
    true = math.degrees(float(drive.yaw(times[-1]) - drive.yaw(0.0)))
    # the sum of at most 30 increments, each right to a hundredth of a column of 0.7 deg
    assert turned == pytest.approx(true, abs=30 * 0.01 * 360 / 512)
    assert cv2.imread(str(tmp_path / "yaw.png")) is not None


def test_example_of_a_bag_gives_a_table(tiny_bag):
    pytest.importorskip("pandas", reason="the example needs pandas")
    text = run_example("bag_to_dataframe.py", tiny_bag)
    end = float(re.search(r"ends at (-?[\d.]+) deg", text).group(1))
    true = math.degrees(float(TinyDrive().yaw(TinyDrive().seconds)))
    # half a column of its 256; the gyro, 0.57 deg/s off, and the tracks, 1.2 times the turn, miss it
    assert end == pytest.approx(true, abs=0.5 * 360 / 256)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_of_the_documentation_lead_to_files(page):
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    targets = {link.split("#")[0] for link in links if not link.startswith(("http:", "https:", "#"))}
    assert not [target for target in targets if not (page.parent / target).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_anchors_of_the_documentation_are_headings(page):
    for target, anchor in re.findall(r"\]\(([^)\s#]*)#([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            text = (page.parent / target if target else page).read_text(encoding="utf-8")
            headings = [heading.strip().lower() for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)]
            assert anchor in {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in headings}


def test_readme_is_read_in_five_minutes():
    """200 words a minute."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 1000
    assert len(text.splitlines()) <= 125


def test_readme_program_runs_as_it_stands():
    """The only block of Python, over a drive of a few images."""
    code = re.search(r"```python\n(.+?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL).group(1)
    tiny = TinyDrive(width=512)
    drive = [(round(1e9 * t), tiny.panorama(t), float(tiny.turn_rate(t))) for t in tiny.times(10.0)]
    names = {"drive": drive}
    exec(code, names)  # our own text
    true = float(tiny.yaw(tiny.times(10.0)[-1]))
    assert names["estimate"].yaw == pytest.approx(true, abs=math.radians(0.5))  # over half a column of 0.7 deg


def test_every_picture_is_shown_on_a_page():
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for picture in (ROOT / "docs" / "figures").glob("*.png"):
        assert f"figures/{picture.name})" in shown, picture.name
        assert picture.stat().st_size < 250_000  # bytes; a page loads at once


def test_tree_in_the_docs_is_that_of_the_packages():
    house = runpy.run_path(str(ROOT / "tests" / "tools" / "house.py"))
    page = (ROOT / "docs" / "house.md").read_text(encoding="utf-8")
    assert house["written"](page) == page, "run PYTHONPATH=tests python -m tools.house"
