"""Do the tests of the safety core notice a change of it? ``python -m tests.mutation --help``."""
