"""Reports: one run on one page with a cursor, and many runs in one table; HTML that needs no network."""
