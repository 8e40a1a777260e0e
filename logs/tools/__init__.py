"""Information, cuts, exports and comparison of logs."""
