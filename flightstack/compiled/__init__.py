"""Functions that numba compiles, and the records that these functions use."""
