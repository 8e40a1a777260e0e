"""HTML reports of flight logs."""
