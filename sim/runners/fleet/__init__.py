"""Several simulated vehicles as one process: each on its own wires, all in one room."""
