"""Functions that numba compiles, and the records that they work on."""
