"""Tools that draw pictures and print tables for the docs; no tests."""
