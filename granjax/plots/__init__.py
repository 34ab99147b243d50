"""Plots: each takes a result, its dataset or arrays, draws into `ax` (or a new figure) and returns the Axes.

They know no lattice: a run is anything with `ts`, `us`, `vs`, a dispersion anything with `k`, `omega`, `cell`.

Units are those of the result. One in SI is drawn with one prefix per axis that reads (µs, mm/s, kHz), chosen from the
range of the numbers; one in scaled numbers says "(scaled)". A dataset holds the unit of each variable, so that
`gx.plots.space_time(run.in_units("us", "mm/s"))` draws microseconds. Arrays have the label that they are given: one
that ends with a unit of SI, "force (N)", gets a prefix, and with any other, "force (lb)", it stays as it is.

Colour maps are perceptually uniform, or diverge evenly from white at zero; line colours are those of Okabe and Ito. All
can be told apart by colour-blind eyes.
"""

from .fits import corner, fit
from .histories import space_time, traces
from .orbits import branch, breather, diagram, floquet_circle, hysteresis
from .plane import beads, film
from .precision import work_precision
from .shocks import modulation, shock
from .style import COLOURS, drawn, figure, save, style
from .sweeps import sweep
from .travelling import wave
from .waves import (
    bands,
    complex_bands,
    density_of_states,
    dispersion,
    floquet_bands,
    transmission,
    zone,
)

__all__ = [
    "COLOURS",
    "bands",
    "beads",
    "branch",
    "breather",
    "complex_bands",
    "corner",
    "density_of_states",
    "diagram",
    "dispersion",
    "drawn",
    "figure",
    "film",
    "fit",
    "floquet_bands",
    "floquet_circle",
    "hysteresis",
    "modulation",
    "save",
    "shock",
    "space_time",
    "style",
    "sweep",
    "traces",
    "transmission",
    "wave",
    "work_precision",
    "zone",
]
