"""Records by long adaptive steps, with their stated errors: by hand, pytest benchmarks/long."""

from test_records import risen_and_fallen, site  # noqa: F401

import granjax as gx


def test_a_crossing_that_rises_and_falls_within_one_step_is_found(site):  # noqa: F811
    """At tolerance 1e-6 the stated error of the integral is 1.05e-6, above its bound."""
    risen_and_fallen(site, dict(solver=gx.RKN1210(), tolerance=1e-6), 1e-6)
