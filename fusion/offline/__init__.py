"""Bags in, results out: reader, writer, report and the command line."""
