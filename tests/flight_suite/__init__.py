"""What the tests that fly any vehicle are made of."""
