"""Verbs that prove: certificate, identification, replay, campaigns."""
