"""Which phase a flight is in, why it changes, and what each phase asks for."""
