"""The one error that granjax raises for bad input."""

import pytest


def refused(match):
    """As `pytest.raises`: a ValueError with this sentence."""
    return pytest.raises(ValueError, match=match)
