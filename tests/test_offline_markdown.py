"""The measured page: each command writes its own section, and a saved evaluation gives the same one again."""

import json
import math

import pytest

from fusion.offline.atomic_output import OutputError
from fusion.offline.cli import main
from fusion.offline.evaluation import command
from fusion.offline.evaluation.outcome import Honesty, Outcome
from fusion.offline.markdown import markdown_table, write_section
from fusion.offline.scores import FUSED, GYRO, Score


def test_table_of_markdown_has_a_line_of_marks():
    assert markdown_table(("a", "b"), [("x", "1")]) == "| a | b |\n| --- | --: |\n| x | 1 |"


def test_sections_are_written_again_without_touching_anything_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# By hand\n\nStays.\n")
    write_section(page, "one", "first")
    write_section(page, "two", "second")
    write_section(page, "one", "third, longer\nthan before")
    text = page.read_text()
    assert text.startswith("# By hand\n\nStays.\n")
    assert "first" not in text
    assert text.index("than before") < text.index("second")
    write_section(page, "one", "first")
    write_section(page, "one", "third, longer\nthan before")
    assert page.read_text() == text


@pytest.mark.parametrize(
    "remains",
    [
        "<!-- one: written by a command, changes are lost -->",
        "<!-- end of one -->",
        "<!-- end of one -->\n<!-- one: written by a command, changes are lost -->",
        2 * "<!-- one: written by a command, changes are lost -->\n<!-- end of one -->\n",
    ],
)
def test_section_with_half_of_its_marks_changes_nothing(tmp_path, remains):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{remains}\nafter\n")
    with pytest.raises(OutputError, match="section one"):
        write_section(page, "one", "text")
    assert page.read_text() == f"before\n{remains}\nafter\n"


def test_page_that_is_no_text_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OutputError, match="as text"):
        write_section(page, "one", "text")


def outcomes(names, seeds, settings, workers, smooth, worlds, methods):
    """The compass answers half of the images; the gyro claims nothing."""
    claims = {"corners": Honesty(1.25, 0.9, 10), GYRO: None, FUSED: Honesty(0.5, 1.0, 20)}
    held_out = worlds != "tuned"
    return [
        Outcome(
            name,
            seed,
            source,
            Score(math.radians(0.1 + seed), math.radians(0.2), math.radians(0.3)),
            math.nan,
            1.0,
            claim,
            0.5 if source == "corners" else math.nan,
            "rubble" if held_out else "0",
            held_out,
        )
        for name in names
        for seed in seeds
        for source, claim in claims.items()
    ]


def test_saved_evaluation_gives_the_same_page(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "evaluate_experiments", outcomes)
    paths = {name: tmp_path / name for name in ("a.json", "b.json", "a.md", "b.md")}
    drives = ["evaluate", "demo", "forward6_passage", "--worlds", "all", "--seeds", "2"]
    assert main([*drives, "--json", str(paths["a.json"]), "--markdown", str(paths["a.md"])]) == 0
    printed = capsys.readouterr().out
    again = ["--json", str(paths["b.json"]), "--markdown", str(paths["b.md"])]
    assert main(["evaluate", str(paths["a.json"]), *again]) == 0
    assert "corners" in capsys.readouterr().out
    assert paths["a.md"].read_text() == paths["b.md"].read_text()
    assert json.loads(paths["a.json"].read_text()) == json.loads(paths["b.json"].read_text())
    assert "rubble" in printed
    page = paths["a.md"].read_text()
    held_out, own = page.index("### Held-out worlds"), page.index("### The experiments' own worlds")
    assert held_out < own
    assert page.count("2 experiments, seeds 0 to 1, 4 drives") == 2
    final = math.sqrt((0.1**2 + 1.1**2) / 2)  # of the two seeds
    assert f"| `forward6_passage` | 6.59 | {final:.3f} | {final:.3f} | {final:.3f} |" in page
    assert "| `demo` | 50.0 | 1.25 | 90.0 | 0.50 | 100.0 |" in page


def test_runs_of_other_seeds_are_joined_to_what_one_run_gives(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "evaluate_experiments", outcomes)
    pages = []
    for name, first, count in (("first", 0, 2), ("rest", 2, 1), ("all", 0, 3)):
        seeds = ["--first-seed", str(first), "--seeds", str(count)]
        assert main(["evaluate", "demo", "weave", *seeds, "--json", str(tmp_path / f"{name}.json")]) == 0
    for name, files in (("joined", ("first", "rest")), ("one", ("all",))):
        joined = ["--json", str(tmp_path / f"{name}.json"), "--markdown", str(tmp_path / name)]
        assert main(["evaluate", *(str(tmp_path / f"{file}.json") for file in files), *joined]) == 0
        pages.append((tmp_path / name).read_text())
    assert pages[0] == pages[1]
    assert "2 experiments, seeds 0 to 2, 6 drives" in pages[0]
    saved = [json.loads((tmp_path / f"{name}.json").read_text()) for name in ("joined", "one")]
    assert saved[0]["summaries_deg"] == saved[1]["summaries_deg"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({}, "demo of seed 0 is in"),  # the same drive twice
        ({"seed": 1, "source": "rows"}, "rows"),  # another method: its table would be of other drives
    ],
)
def test_runs_that_do_not_belong_together_are_refused(monkeypatch, tmp_path, capsys, change, complaint):
    monkeypatch.setattr(command, "evaluate_experiments", outcomes)
    paths = tmp_path / "a.json", tmp_path / "b.json"
    assert main(["evaluate", "demo", "--json", str(paths[0])]) == 0
    content = json.loads(paths[0].read_text())
    content["outcomes_rad"][0] |= change
    content["outcomes_rad"] = [one for one in content["outcomes_rad"] if one["seed"] == change.get("seed", 0)]
    paths[1].write_text(json.dumps(content))
    capsys.readouterr()
    assert main(["evaluate", *map(str, paths), "--markdown", str(tmp_path / "page.md")]) == 1
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "page.md").exists()


def test_drive_that_a_file_holds_already_is_refused_before_it_is_driven(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "evaluate_experiments", outcomes)
    path = tmp_path / "a.json"
    assert main(["evaluate", "demo", "--worlds", "rubble", "--json", str(path)]) == 0
    monkeypatch.delattr(command, "evaluate_experiments")
    assert main(["evaluate", str(path), "demo", "--worlds", "rubble"]) == 1
    assert "--first-seed 1" in capsys.readouterr().err


def test_file_that_is_no_evaluation_is_one_line(tmp_path, capsys):
    path = tmp_path / "other.json"
    for content in ("{}", "[]", "no json", '{"outcomes_rad": [{}], "drifts_rad_s": {}, "default_method": "corners"}'):
        path.write_text(content)
        assert main(["evaluate", str(path)]) == 1
        error = capsys.readouterr().err
        assert "other.json" in error
        assert "evaluate --json" in error
        assert len(error.splitlines()) == 1


def test_headlines_are_the_median_and_the_worst_of_held_out_drives(monkeypatch, tmp_path, capsys):
    def two_drives(names, seeds, settings, workers, smooth, worlds, methods):
        scale = 1.0 if worlds != "tuned" else 50.0
        return [
            Outcome(name, 0, FUSED, Score(scale * math.radians(final), 0.0, 0.0), 1.0, 1.0, None, math.nan, world, held)
            for name, final in (("spin3_indoor", -0.1), ("spin5_yard", 0.4), ("shifted", 9.0))
            for world, held in ((("rubble", True),) if worlds != "tuned" else (("0", False),))
        ]

    monkeypatch.setattr(command, "evaluate_experiments", two_drives)
    page = tmp_path / "page.md"
    assert main(["evaluate", "spin3_indoor", "spin5_yard", "--worlds", "all", "--headline", str(page)]) == 0
    lines = [line for line in page.read_text().splitlines() if line.startswith("| ")]
    assert [line.split("|")[-2].strip() for line in lines[2:]] == ["0.250", "0.250", "0.400"]
    assert lines[2].startswith("| turns on the spot, median of 2 |")
    assert "1 seed each, in worlds in which no constant was chosen" in page.read_text()


def test_headlines_without_simulated_drives_say_so(tiny_bag, tmp_path, capsys):
    assert main(["evaluate", str(tiny_bag), "--headline", str(tmp_path / "page.md")]) == 1
    assert "--headline" in capsys.readouterr().err
    assert not (tmp_path / "page.md").exists()
