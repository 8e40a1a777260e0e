"""Start and supervision of the processes in one flight, and its printed result."""
