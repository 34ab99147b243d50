"""Plots: each takes a result, its dataset or arrays, and returns the Axes.

Each draws into `ax`, or a new figure. They need no lattice: a run is anything with `ts`, `us`,
`vs`, a dispersion anything with `k`, `omega`, `cell`.

Axes have the units of the result, in SI with one prefix each (us, mm/s, kHz), chosen from the range
of the numbers; scaled numbers are labelled "(scaled)". A dataset holds the unit of each variable:
`gx.plots.space_time(run.in_units("us", "mm/s"))` draws microseconds. Arrays get the given label; an
SI unit in it, "force (N)", gets a prefix, any other, "force (lb)", is unchanged.

Colour maps are perceptually uniform, or diverge evenly from white at zero; line colours are those
of Okabe and Ito. All are safe for colour-blind readers.
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
