"""granjax is imported before JAX starts computing, so that its float type and XLA flags are in force for every test."""

import granjax


def pytest_report_header(config):
    return f"granjax {granjax.__version__}: {granjax.tune().message}"
