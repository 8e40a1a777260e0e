"""What every room may use: signals, child processes, pacing, strict TOML, the clock of a simulation."""
