"""Numbers as they are said."""

import math


def number(x):
    """Three digits: 0.0123, 2.3e-09."""
    return f"{x:.3g}"


def seconds_in_words(seconds):
    """A time with its unit: 1.9 ms."""
    if not math.isfinite(seconds):
        return "no time"
    unit, name = next(((u, n) for u, n in ((1.0, "s"), (1e-3, "ms")) if seconds >= u), (1e-6, "us"))
    return f"{seconds / unit:.3g} {name}"
