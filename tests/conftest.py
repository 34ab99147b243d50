"""granjax is imported before JAX starts computing, so that its float type and XLA flags are in force for every test.

Before that the import hook is set, with which every annotation is checked (tests/typed.py).
"""

import os

import pytest
import typed

typed.install()

import granjax  # noqa: E402

# the command line, called by tests, keeps nothing in the user's cache folder
os.environ["GRANJAX_CACHE"] = "0"


def pytest_report_header(config):
    return f"granjax {granjax.__version__}: {granjax.tune().message}"


@pytest.fixture
def ax():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots()
    yield ax
    plt.close(figure)
