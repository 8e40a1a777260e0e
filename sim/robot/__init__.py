"""The moving target."""
