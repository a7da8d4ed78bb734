"""Apply mutants one at a time to a copy of the tree, and say which of them the tests notice.

    PYTHONPATH=tests python -m mutants [NAME ...]

NAMEs are parts of mutants' names; none: all. Exit status: 0 where each is noticed or known to survive; 1 where one
survives, no longer applies or cannot be tried; 2 where the tests fail without any mutant.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from mutants.catalogue import MUTANTS
from mutants.mutant import Mutant, Outcome

ROOT = Path(__file__).parents[2]
LONGEST = 300  # s; a mutant that hangs is noticed
PASSED, FAILED = 0, 1  # exit codes of pytest; others say that it could not run the tests


def copy_tree(to: Path) -> None:
    """What git has or would take in, as it stands in the work tree."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        source, target = ROOT / name, to / name
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read_bytes())


def run_tests(tree: Path, tests: Iterable[str], longest: float = LONGEST) -> tuple[int, str]:
    """Exit code of pytest, and the test that failed; `FAILED` where it takes longer than `longest` seconds."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    paths = f"{tree}{os.pathsep}{tree / 'tests'}"
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    with tempfile.TemporaryFile("w+") as said:
        try:
            code = subprocess.run(
                command, cwd=tree, env=environment, stdout=said, stderr=said, timeout=longest, check=False
            ).returncode
        except subprocess.TimeoutExpired:
            return FAILED, "none, in time"
        said.seek(0)
        text = said.read()
    if code not in (PASSED, FAILED):
        print(text)
    failed = [line.split()[1] for line in text.splitlines() if line.startswith("FAILED ")]
    return code, ", ".join(failed)


def outcome(mutant: Mutant, tree: Path) -> tuple[Outcome, str]:
    """What becomes of a mutant in a copy of the tree, which is left as it was; and the test that noticed it."""
    changed = mutant.applied(tree)
    if changed is None:
        return Outcome.STALE, ""
    path = tree / mutant.file
    kept = path.read_bytes()
    path.write_text(changed, encoding="utf-8")
    try:
        code, failed = run_tests(tree, mutant.tests)
    finally:
        path.write_bytes(kept)
    if code == PASSED:
        return (Outcome.KNOWN if mutant.survives else Outcome.SURVIVED), ""
    if code != FAILED:
        return Outcome.BROKEN, failed
    return (Outcome.MENDED if mutant.survives else Outcome.NOTICED), failed


def main() -> int:
    """Try the mutants that were asked for."""
    parser = argparse.ArgumentParser("mutants", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a mutant's name")
    names = parser.parse_args().names
    chosen = [mutant for mutant in MUTANTS if not names or any(name in mutant.name for name in names)]
    if not chosen:
        parser.error(f"no mutant is called so; there are: {', '.join(mutant.name for mutant in MUTANTS)}")
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder) / "tree"
        copy_tree(tree)
        code, failed = run_tests(tree, dict.fromkeys(test for one in chosen for test in one.tests), 4 * LONGEST)
        if code != PASSED:
            print(f"the tests fail without any mutant: {failed}")
            return 2
        outcomes = []
        for mutant in chosen:
            one, failed = outcome(mutant, tree)
            outcomes.append(one)
            print(f"{one.value}: {mutant.name} ({mutant.file}){failed and f' by {failed}'}", flush=True)
    counts = Counter(one.value for one in outcomes)
    print("; ".join(f"{count} {what}" for what, count in counts.items()))
    return 0 if all(one.good for one in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
