"""The reports in a real browser: opened from a file, the cursor moves, nothing is fetched and nothing complains."""

import itertools
import json
import re
import shutil
import subprocess
import sys
import urllib.parse
from pathlib import Path

import numpy as np
import pytest
from tiny_bags import START_NS, TinyBag, TinyDrive

from fusion.offline import worker_pool
from fusion.offline.bag_task import run_task
from fusion.offline.cli import main
from fusion.offline.report import thumbnails

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
NAME = "a <b> & $c.mcap"  # all that HTML could take for its own
FIGURES = "const found = [...Bokeh.documents[0]._all_models.values()].filter(model => model.type === 'Figure');"
BOX = (
    FIGURES + "const r = Bokeh.index.find_one(found[0]).el.getBoundingClientRect();"
    "return [r.left, r.top, r.width, r.height]"
)


@pytest.fixture(scope="module")
def results(tiny_bag, tmp_path_factory):
    """Two runs with reports: all sensors, and a gyro that pauses beside tracks."""
    pytest.importorskip("bokeh", reason="reports need Bokeh")
    folder = tmp_path_factory.mktemp("report")
    shutil.copy(tiny_bag, folder / NAME)
    drive = TinyDrive(seconds=6.0)
    with TinyBag(folder / "gyro") as bag:
        for t in drive.times(100):
            if not 2.0 < t < 4.0:
                bag.imu("/imu/data", START_NS + round(t * 1e9), float(drive.turn_rate(t)))
        for t in drive.times(20):
            bag.odometry("/odom", START_NS + round(t * 1e9), float(drive.yaw(t)), float(drive.turn_rate(t)))
    out = folder / "results"
    assert main(["fuse", str(folder / NAME), "--out", str(out / NAME), "--report"]) == 0
    assert main(["fuse", str(folder / "gyro"), "--out", str(out / "gyro"), "--report"]) == 0
    assert main(["report", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    webdriver = pytest.importorskip("selenium.webdriver", reason="the browser is driven by Selenium")
    if not (CHROMIUM and DRIVER):
        pytest.skip("no chromium with its chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for switch in (
        *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1200,1500"),
        *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run"),
        f"--user-data-dir={tmp_path_factory.mktemp('chromium')}",
    ):
        options.add_argument(switch)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def opened(browser, page: Path, ready: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get("file://" + urllib.parse.quote(str(page)))
    WebDriverWait(browser, 60).until(lambda b: b.execute_script(f"return {ready}"))


def complaints(browser) -> list[str]:
    return [one["message"] for one in browser.get_log("browser") if one["level"] in ("SEVERE", "WARNING")]


def point_at(browser, share: float) -> float:
    """Move the mouse over the first panel, so far across it; gives the time that is shown then."""
    from selenium.webdriver.common.action_chains import ActionBuilder

    left, top, width, height = browser.execute_script(BOX)
    mouse = ActionBuilder(browser)
    mouse.pointer_action.move_to_location(round(left + share * width), round(top + 0.5 * height))
    mouse.perform()
    return float(browser.execute_script("return document.getElementById('time').textContent"))


def test_report_shows_the_panorama_and_the_lines_at_the_cursor(browser, results):
    page = results / NAME / "report.html"
    opened(browser, page, "window.Bokeh?.index?.roots?.length > 0")
    assert browser.title == NAME
    assert browser.execute_script("return document.querySelector('h1').textContent") == NAME
    picture = "return document.getElementById('panorama').src"
    first = browser.execute_script(picture)
    times, pictures = [], []
    for share in (0.2, 0.4, 0.6):
        times.append(point_at(browser, share))
        pictures.append(browser.execute_script(picture))
    assert 0.0 < times[0] < times[1] < times[2] < TinyDrive().seconds
    assert len({first, *pictures}) == 4
    # the picture is the newest that had been taken by then, of those that the page holds
    held = json.loads(browser.execute_script("return document.getElementById('thumbnails').textContent"))
    for t, shown in zip(times, pictures, strict=True):
        assert held["picture"].index(shown) == max(i for i, taken in enumerate(held["t"]) if taken <= t + 0.005)
    lines = browser.execute_script(
        FIGURES + "return found.map(f => f.center.filter(m => m.type === 'Span' && m.dimension === 'height')[0])"
        ".map(line => [line.visible, line.location])"
    )
    assert len(lines) >= 6
    assert all(visible and location == pytest.approx(times[-1], abs=0.006) for visible, location in lines)
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    assert complaints(browser) == []


def test_report_zooms_all_panels_where_the_mouse_was_dragged(browser, results):
    from selenium.webdriver.common.action_chains import ActionBuilder

    opened(browser, results / NAME / "report.html", "window.Bokeh?.index?.roots?.length > 0")
    begin, end = point_at(browser, 0.2), point_at(browser, 0.5)
    left, top, width, height = browser.execute_script(BOX)
    mouse = ActionBuilder(browser)
    mouse.pointer_action.move_to_location(round(left + 0.2 * width), round(top + 0.5 * height)).pointer_down()
    mouse.pointer_action.move_to_location(round(left + 0.5 * width), round(top + 0.6 * height)).pointer_up()
    mouse.perform()
    ranges = browser.execute_script(FIGURES + "return found.map(f => [f.x_range.start, f.x_range.end])")
    assert len(ranges) >= 6
    for shown in ranges:
        assert shown == pytest.approx([begin, end], abs=0.01)  # 1 px is 0.004 s
    assert complaints(browser) == []


def test_report_lights_the_warnings_that_hold_at_the_cursor(browser, results):
    summary = json.loads((results / "gyro" / "summary.json").read_text())
    assert [one["code"] for one in summary["warnings"] if one["until_s"] is not None] == ["sensor_silent"]
    opened(browser, results / "gyro" / "report.html", "window.Bokeh?.index?.roots?.length > 0")
    for share in (0.15, 0.35, 0.7):
        t = point_at(browser, share)
        rows = browser.execute_script(
            "return [...document.querySelectorAll('#warnings tr')]"
            ".map(row => [row.dataset.spans, row.className, row.textContent])"
        )
        for (spans, shown, text), warning in zip(rows, summary["warnings"], strict=True):
            holds = any(since <= t <= until for since, until in json.loads(spans))
            near_an_edge = any(abs(t - edge) < 0.01 for span in json.loads(spans) for edge in span)
            assert near_an_edge or (shown == "held") == holds
            assert warning["text"] in text
    assert complaints(browser) == []


def test_report_of_a_run_that_measured_nothing_opens_without_complaint(browser, tmp_path):
    with TinyBag(tmp_path / "dark") as bag:
        for t in TinyDrive().times(10):
            bag.compressed("/pano/compressed", START_NS + round(t * 1e9), np.zeros((32, 64), np.uint8))
    assert main(["fuse", str(tmp_path / "dark"), "--out", str(tmp_path / "out"), "--report"]) == 0
    opened(browser, tmp_path / "out" / "report.html", "window.Bokeh?.index?.roots?.length > 0")
    assert 0.0 < point_at(browser, 0.5) < TinyDrive().seconds
    assert complaints(browser) == []


def test_table_of_many_runs_sorts_and_links(browser, results):
    opened(browser, results / "report.html", "document.querySelectorAll('tbody tr').length > 0")
    column = "return [...document.querySelectorAll('tbody tr')].map(row => row.cells[arguments[0]].textContent)"
    click = "document.querySelectorAll('th')[arguments[0]].click()"
    durations = []
    for _ in range(2):
        browser.execute_script(click, 1)
        durations.append([float(cell) for cell in browser.execute_script(column, 1)])
    assert durations == [[3.0, 6.0], [6.0, 3.0]]
    for _ in range(2):  # the gyro alone was scored against nothing: unknown errors stay last
        browser.execute_script(click, 4)
        assert browser.execute_script(column, 4)[-1] == ""
    browser.execute_script(click, 0)
    assert browser.execute_script(column, 0) == [NAME, "gyro"]
    browser.execute_script("document.querySelector('tbody a').click()")
    assert browser.title == NAME
    assert complaints(browser) == []


def test_reports_of_many_runs_come_with_their_table(tiny_bag, tmp_path, monkeypatch):
    pytest.importorskip("bokeh", reason="reports need Bokeh")
    # here: a process for them takes longer to start than they take
    monkeypatch.setattr(worker_pool, "run_in_processes", lambda tasks, jobs, part: map(run_task, tasks))
    for name in ("a.mcap", "b.mcap"):
        shutil.copy(tiny_bag, tmp_path / name)
    out, bags = tmp_path / "out", [str(tmp_path / name) for name in ("a.mcap", "b.mcap")]
    assert main(["fuse", *bags, "--out", str(out), "--jobs", "1"]) == 0
    assert not list(out.rglob("report.html"))
    # finished without reports is not finished with them
    assert main(["fuse", *bags, "--out", str(out), "--jobs", "1", "--report"]) == 0
    assert 'href="a_yaw/report.html"' in (out / "report.html").read_text()
    assert (out / "a_yaw" / "report.html").exists()
    assert (out / "b_yaw" / "report.html").exists()


def test_report_is_of_bounded_size(results):
    """The library is 1.4 MB; the rest is curves and pictures."""
    assert (results / NAME / "report.html").stat().st_size < 3_000_000


@pytest.mark.parametrize("count", [0, 100, 333])
def test_thumbnails_are_spread_over_a_run_of_any_length(count, monkeypatch):
    monkeypatch.setattr(thumbnails, "MOST", 20)
    drive = TinyDrive(width=32)
    frames = [thumbnails.Frame(index, drive.panorama(0.1 * index)) for index in range(333)]

    class Recording:
        frame_count = count  # a video's container may not know, or be wrong

        def frames(self):
            return iter(frames)

    watched = thumbnails.Thumbnails(Recording())
    assert list(watched.frames()) == frames
    times = [t for t, _ in watched.pictures]
    assert 10 <= len(times) <= 20
    assert len({b - a for a, b in itertools.pairwise(times)}) == 1
    assert times[0] == 0
    assert times[-1] > 333 - 2 * times[1]


def refusal(capsys, *arguments: object) -> str:
    assert main([str(argument) for argument in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_report_without_bokeh_names_the_extra_before_anything_is_fused(tiny_bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "bokeh", None)
    assert "visual-compass[report]" in refusal(capsys, "fuse", tiny_bag, "--out", tmp_path / "out", "--report")
    assert not (tmp_path / "out").exists()


def test_rerun_without_its_library_names_the_extra(tiny_bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert "visual-compass[rerun]" in refusal(capsys, "fuse", tiny_bag, "--out", tmp_path / "out", "--rerun")
    assert not (tmp_path / "out").exists()


def test_rerun_holds_yaws_panoramas_and_stamps(tiny_bag, tmp_path):
    pytest.importorskip("rerun", reason="needs the Rerun SDK")
    fused = [
        sys.executable,
        "-m",
        "fusion.offline.cli",
        "fuse",
        str(tiny_bag),
        "--out",
        str(tmp_path / "out"),
        "--rerun",
    ]
    said = subprocess.run(fused, capture_output=True, text=True, check=True).stderr
    assert "WARN" not in said  # by the library itself, of names that are not escaped
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "out" / "run.rrd")]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    images = TinyDrive().times(10.0).size
    assert f"with {images} rows" in next(line for line in text.splitlines() if "/panorama" in line)
    assert {"truth", "fused", "raw\\ compass"} <= set(re.findall(r"/yaw_deg/((?:\\ |\w)+)", text))


def test_table_of_what_are_no_results_is_refused_in_a_line(tmp_path, capsys):
    assert "no folder" in refusal(capsys, "report", tmp_path / "nothing")
    assert "holds a summary.json" in refusal(capsys, "report", tmp_path)
    (tmp_path / "run").mkdir()
    for content in ("[1]", "{", "\x00", '{"a": ' * 100_000):
        (tmp_path / "run" / "summary.json").write_text(content)
        assert "no summary of ours" in refusal(capsys, "report", tmp_path)
    (tmp_path / "run" / "summary.json").write_text('{"yaw": 3, "warnings": "none", "duration_s": "long"}')
    (tmp_path / "report.html").write_text("mine")
    assert "would be lost" in refusal(capsys, "report", tmp_path)
    assert (tmp_path / "report.html").read_text() == "mine"
    (tmp_path / "report.html").unlink()
    assert main(["report", str(tmp_path)]) == 0
    assert "results of one run" in refusal(capsys, "report", tmp_path / "run")
