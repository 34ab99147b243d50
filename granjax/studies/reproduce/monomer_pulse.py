"""Figures 1.4 and 1.5: a striker hits a chain of steel beads, as a laser vibrometer would see it."""

import numpy as np
import xarray as xr

from ...checks import positive, whole
from ...flow import Peak, simulate
from ...materials import bead_mass, hertz_coefficient
from ...measures import front_speed
from ...scenes import beads as bead_chain
from ...states import impact
from ...types import Count, Scalar
from .figure import Choice, Figure

# a striker of the beads' own mass, long chain, A = m = v = 1
PEAK_VELOCITY, SPEED = 0.68163155, 0.84050877
_SOURCE = "converged simulation of a long chain, A = m = v = 1, by two independent methods"
_FIRST = 10
_LEAST = 24


def _velocity(t, y, lattice):
    return y.v


def compute(material: str, radius: Scalar, striker: Scalar, beads: Count) -> xr.Dataset:
    """Velocities of all beads [m/s] until the pulse is near the end; bead 0 is the striker, a bead like the others."""
    beads = whole("beads", beads, _LEAST, "The pulse needs some ten beads to take its shape.")
    striker = float(positive("striker", striker, "It is the striker's velocity in m/s."))
    A, m = float(hertz_coefficient(material, radius)), float(bead_mass(material, radius))
    # sites per second in units of the solitary wave's scaling law
    rate = (A * A * striker / (m * m)) ** 0.2
    lattice = bead_chain(material, radius, cells=beads, boundary="free")
    run = simulate(lattice, impact(lattice, striker), (beads - 2) / (SPEED * rate), save_at=601,
                   record={"peak": Peak(_velocity)})
    attributes = {
        "rate": rate, "striker": striker, "diameter": 2 * radius, "stiffness": A, "mass": m, "material": material,
        "solver": run.solver, "method": run.choice,
    }
    return xr.Dataset(
        {
            "velocity": (("time", "bead"), np.asarray(run.vs), {"units": "m/s"}),
            "peak": ("bead", np.asarray(run.recorded["peak"]), {"units": "m/s"}),
        },
        {"time": ("time", np.asarray(run.ts), {"units": "s"}), "bead": np.arange(beads)},
        attributes,
    )


def _front(data):
    """Beads per second, from the times of the peaks of the beads between the tenth and the fourth from the end."""
    n = np.arange(_FIRST, data.sizes["bead"] - 6)
    return float(front_speed(data["time"].values, data["velocity"].values, n).speed)


def scaled_speed(data: xr.Dataset) -> float:
    """Speed of the pulse over (A^2 v/m^2)^{1/5}."""
    return _front(data) / data.attrs["rate"]


def scaled_peak(data: xr.Dataset) -> float:
    """Largest velocity of the bead two thirds down the chain over the striker's."""
    return float(data["peak"].values[2 * data.sizes["bead"] // 3]) / data.attrs["striker"]


def _draw_traces(plots, figure, data):
    overlaid, stacked = figure.subplots(1, 2)
    middle = data.sizes["bead"] // 2
    shown = np.arange(middle - 2, middle + 3)
    ts = data["time"].values
    velocity = data["velocity"].values
    options = {"units": ("us", "m/s"), "label": "velocity", "site_label": "bead"}
    plots.traces(ts, velocity, shown, overlaid, offset=0, **options)
    at = 1e6 * ts[velocity[:, shown].argmax(0)]
    around = 3 * (at[-1] - at[0]) / (len(shown) - 1)
    overlaid.set_xlim(at[0] - around, at[-1] + 1.4 * around)
    overlaid.set_title("Five adjacent beads")
    plots.traces(ts, velocity, np.arange(2, data.sizes["bead"] - 2, 4), stacked, **options)
    stacked.set_title("Every fourth bead")


def _draw_map(plots, figure, data):
    ax = figure.subplots()
    plots.space_time(data["velocity"].values, ax, ts=data["time"].values, sites=data["bead"].values, label="velocity",
                     units=("us", "m/s"), site_label="bead", limit=1.05 * PEAK_VELOCITY * data.attrs["striker"])
    speed = _front(data) * data.attrs["diameter"]
    ax.text(0.97, 0.05, f"pulse {speed:.0f} m/s", transform=ax.transAxes, ha="right", color="0.2")
    ax.set_title("Velocity of every bead")


_CHOSEN = {
    "material": Choice("chrome steel", "", "of beads and striker"),
    "radius": Choice(9.525e-3, "m", "of beads and striker"),
    "striker": Choice(0.4, "m/s", "velocity of the striker, a bead like the others"),
    "beads": Choice(32, "", "number of beads, the striker included"),
}

FIGURES = (
    Figure(
        label="fig1.4",
        title="Velocities of adjacent beads of a granular chain",
        caption="Simulation of the experiment: a striker hits a chain of equal spheres in contact without "
        "precompression; Hertz contacts, no friction, rotation or losses.",
        compute=compute,
        draw=_draw_traces,
        number=scaled_peak,
        quantity="peak bead velocity / striker velocity",
        expected=PEAK_VELOCITY,
        tolerance=2e-5,
        source=_SOURCE,
        chosen=_CHOSEN,
    ),
    Figure(
        label="fig1.5",
        title="Space-time plot of the bead velocities of a granular chain",
        caption="The simulation of fig1.4, all beads.",
        compute=compute,
        draw=_draw_map,
        number=scaled_speed,
        quantity="pulse speed [beads/s] / (A^2 v/m^2)^(1/5)",
        expected=SPEED,
        tolerance=2e-5,
        source=_SOURCE,
        chosen=_CHOSEN,
        size=(5.4, 4.0),
    ),
)
