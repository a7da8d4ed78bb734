"""Markdown: tables, and files whose sections are each written by a command of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fusion.offline.atomic_output import OutputError, staged_file


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Table whose first `left` columns are flush left and the others flush right."""
    marks = ["---" if column < left else "--:" for column in range(len(header))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, marks, *rows))


def write_section(path: Path, name: str, text: str) -> None:
    """Put `text` between the marks of section `name` in the file; all else in it stays.

    A file without that section gets it at its end, and a file that is not there is made.

    Raises
    ------
    OutputError
        The file is no text in UTF-8, its marks are not one pair, or its place cannot be written to.
    """
    try:
        content = path.read_text(encoding="utf-8") if path.exists() else ""
    except (OSError, UnicodeError) as error:
        raise OutputError(f"{path}: cannot be read as text ({error}); give another file") from error
    begin, end = f"<!-- {name}: written by a command, changes are lost -->", f"<!-- end of {name} -->"
    before, found, rest = content.partition(begin)
    _, closed, after = rest.partition(end)
    if content.count(begin) > 1 or content.count(end) != len(closed) // len(end):
        raise OutputError(f"{path}: section {name} needs one '{begin}' and then one '{end}'; delete what is left of it")
    if not found:
        before = f"{content.rstrip()}\n\n" if content.strip() else ""
        after = "\n"
    elif not closed:
        raise OutputError(f"{path}: section {name} does not end; put '{end}' after it")
    with staged_file(path) as staged:
        staged.write_text(f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}", encoding="utf-8")
