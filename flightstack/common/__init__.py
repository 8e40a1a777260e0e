"""Modules for all packages: signals, child processes, options, clocks of ticks, strict TOML, text."""
