"""Flight logs: recorder, reader, verdict and report."""
