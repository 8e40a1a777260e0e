"""Several simulated vehicles in one room: without wires (team), or each on wires of its own (process)."""
