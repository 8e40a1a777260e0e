"""Modules for all packages: signals, child processes, pacing, strict TOML, the clock of a simulation."""
