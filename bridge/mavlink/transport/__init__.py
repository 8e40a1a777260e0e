"""UDP, TCP and serial lines."""
