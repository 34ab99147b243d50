"""Plots: each takes arrays or a run, draws into `ax` (or a new figure of the house style) and returns the Axes.

They know no lattice: a run is anything with `ts`, `us`, `vs`, a dispersion anything with `k`, `omega`, `cell`.

Units are those of the result, and asked for in one way everywhere, by `units=`:

- `None`: a result in SI is drawn with the prefixes that read (µs, mm/s, kHz), one in scaled numbers says "(scaled)".
- words, each for the axes of its dimension: `"us"`, `("kHz", "us", "mm/s")`, `"rad/s"`. They say of arrays that these
  are in SI, as `"SI"` does; `"scaled"` says that they are not.
- a `gx.Units`: scaled numbers are drawn in SI, `(units, "us")` in those words; a result in SI is drawn scaled.

A label that ends with a unit of its own, "force (lb)", is drawn as it stands, and its numbers are left alone. Colour
maps are perceptually uniform, or diverge evenly from white at zero; line colours are those of Okabe and Ito. All can
be told apart by colour-blind eyes.
"""

from .cells import cell_wave, resonance_map
from .curves import profile, transmission
from .evolutions import evolution, gap_breather
from .films import film
from .fits import corner, fit, law, planar
from .histories import space_time, traces
from .orbits import branch, breather, floquet_circle, hysteresis, strain_map
from .plane import bands, beads, radial_profile, zone
from .precision import work_precision
from .rest import equilibrium, kink
from .shocks import modulation, shock, shock_core, shock_map
from .style import COLOURS, drawn, figure, save, style
from .sweeps import sweep
from .travelling import front, reflection, wave, wave_errors, wave_family
from .waves import dispersion, floquet_bands

__all__ = [
    "COLOURS",
    "bands",
    "beads",
    "branch",
    "breather",
    "cell_wave",
    "corner",
    "dispersion",
    "drawn",
    "equilibrium",
    "evolution",
    "figure",
    "film",
    "fit",
    "floquet_bands",
    "floquet_circle",
    "front",
    "gap_breather",
    "hysteresis",
    "kink",
    "law",
    "modulation",
    "planar",
    "profile",
    "radial_profile",
    "reflection",
    "resonance_map",
    "save",
    "shock",
    "shock_core",
    "shock_map",
    "space_time",
    "strain_map",
    "style",
    "sweep",
    "traces",
    "transmission",
    "wave",
    "wave_errors",
    "wave_family",
    "work_precision",
    "zone",
]
