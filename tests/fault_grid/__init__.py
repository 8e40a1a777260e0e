"""The grid of faults: what must become of a flight when any part fails in any way in any phase."""
