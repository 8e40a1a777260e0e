"""Sets the number of random examples of a property test: the stated number, in `make quick` a quarter."""

from typing import Any

from hypothesis import settings

QUICK = "quick"  # name of the profile


def examples(number: int, **more: Any) -> settings:
    """Return the settings of a property test."""
    quick = settings.get_current_profile_name() == QUICK
    return settings(max_examples=max(5, number // 4) if quick else number, **more)
