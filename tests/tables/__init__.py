"""Makes the packaged tables that come from other projects; ``python -m tests.tables`` says how."""
