"""HTML reports of logs."""
