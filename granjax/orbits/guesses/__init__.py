"""Where Newton's method may start: the envelope's bright and dark breathers, sites that oscillate alone."""

from .envelope import (
    bright_guess,
    cell_of,
    dark_guess,
    edge_of,
    edges_beside,
    refuse_bright,
    supports_bright,
)
from .sites import single_site

__all__ = [
    "bright_guess",
    "cell_of",
    "dark_guess",
    "edge_of",
    "edges_beside",
    "refuse_bright",
    "single_site",
    "supports_bright",
]
