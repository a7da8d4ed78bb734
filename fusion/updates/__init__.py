"""One file a sensor: its measurement model, its gate, its recovery."""
