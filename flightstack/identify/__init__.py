"""Lags and gains of the velocity loop, from logs."""
