"""Tests that must not run side by side are told so to the workers."""

import pytest


@pytest.mark.xdist_group("told")
def test_groups_reach_the_workers(request):
    """They travel in the ids of the tests: a pytest that hides those runs everything side by side, unsaid."""
    if hasattr(request.config, "workerinput"):
        assert request.node.nodeid.endswith("@told")
