"""Makes HTML reports from flight logs."""
