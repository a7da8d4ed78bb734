"""Mutants: small changes made to the code on purpose, each with the tests that are to notice it; `make mutants`."""
