"""Several vehicles at once, without a leader: rows that keep them apart, and who lands first."""
