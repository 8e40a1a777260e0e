"""Parameter files of the simulated vehicles."""
