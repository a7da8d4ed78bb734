"""Writes the tree of the packages, a line per file, into docs/house.md: `PYTHONPATH=tests python -m tools.house`.

The line is the first of the file's docstring. `tests/test_docs.py` holds the page to it.
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "house.md"
BEGIN, END = "<!-- tree: written by tests/tools/house.py, changes are lost -->\n", "<!-- end of the tree -->\n"
PACKAGES = ("compass", "fusion", "nodes")


def tree() -> str:
    """All rooms and files, as Markdown."""
    return "\n".join(f"### {name}/\n\n{_room(ROOT / name)}" for name in PACKAGES)


def written(page: str) -> str:
    """The page with the tree as it is now."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "\n" + tree() + END + rest.split(END)[1]


def _room(folder: Path, indent: str = "") -> str:
    lines = [
        f"{indent}- `{file.stem}`: {_first_line(file)}"
        for file in sorted(folder.glob("*.py"))
        if file.stem != "__init__"
    ]
    for room in sorted(path for path in folder.iterdir() if (path / "__init__.py").exists()):
        lines.append(f"{indent}- **{room.name}/** {_first_line(room / '__init__.py')}")
        lines.append(_room(room, indent + "    ").rstrip("\n"))
    return "\n".join(lines) + "\n\n" * (not indent)


def _first_line(file: Path) -> str:
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n")[0]


if __name__ == "__main__":
    argparse.ArgumentParser(prog="python -m tools.house", description=__doc__).parse_args()
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
