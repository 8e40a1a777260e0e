"""Makes HTML reports of logs."""
