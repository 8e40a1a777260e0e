"""Start and supervision of the processes of one flight, and its printed result."""
