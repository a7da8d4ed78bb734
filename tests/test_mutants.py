"""The list of mutants is kept true: each still applies, and names tests that are there."""

import ast
from pathlib import Path

import pytest
from mutants.catalogue import MUTANTS

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_mutant_still_applies_and_its_tests_are_there(mutant):
    changed = mutant.applied(ROOT)
    assert changed is not None, f"{mutant.old!r} does not occur once in {mutant.file}: mend the list"
    assert changed != (ROOT / mutant.file).read_text(encoding="utf-8")
    compile(changed, mutant.file, "exec")
    for test in mutant.tests:
        file, *name = test.split("::")
        known = {node.name for node in ast.parse((ROOT / file).read_text()).body if isinstance(node, ast.FunctionDef)}
        assert set(name) <= known


def test_mutants_have_names_of_their_own():
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)


def test_nine_mutants_of_ten_are_to_be_noticed():
    survivors = sum(bool(mutant.survives) for mutant in MUTANTS)
    assert survivors <= len(MUTANTS) // 10
