"""Tools that summarise, compare and identify from logs."""
