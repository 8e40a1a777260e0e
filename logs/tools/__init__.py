"""Information, repair, exports and comparison of logs."""
