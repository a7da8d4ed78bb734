"""Every sensor times every fault over three drives, through the pipeline; ``make torture`` writes docs/faults.md."""
