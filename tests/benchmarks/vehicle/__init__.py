"""The simulated vehicle against published numbers and linear analysis, and its speed."""
