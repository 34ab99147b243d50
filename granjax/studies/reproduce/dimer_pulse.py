"""Figures 2.3 to 2.5: the first resonance of a dimer chain, as a laser vibrometer would see it."""

import numpy as np
import xarray as xr

from ...checks import positive, whole
from ...flow import Peak, simulate
from ...materials import bead_mass, hertz_coefficient
from ...measures import contact_force
from ...scenes import beads as bead_chain
from ...states import impact
from ...types import Count, Scalar
from .figure import Choice, Figure

# the review's first resonance, light over heavy
RATIO = 0.59
# force of a monomer's pulse far down the chain, A = m = v = 1
MONOMER_FORCE = 0.63955423
CONTACT, HEAVY, LIGHT = 100, 40, 41
_LEAST = 110
# time per bead that the slowing front needs, and step, in units of A = m = v = 1
_SLOWNESS, _STEP = 1.17, 0.05
# later the motion behind the pulse depends on rounding: integrators part by a tenth of the striker's velocity at 120
_HORIZON = 100
_SOURCE = "SciPy's DOP853, relative tolerances 1e-10 and 1e-12 agreeing to 1e-7"


def _force(t, y, lattice):
    return contact_force(lattice, y)


def _velocity(t, y, lattice):
    return y.v


def compute(material: str, radius: Scalar, striker: Scalar, beads: Count) -> xr.Dataset:
    """Velocities [m/s] and peak contact forces [N] of a chain of heavy and light spheres in turn, struck at its end.

    Bead 0 is the striker, a heavy bead; contact n lies between the beads n and n + 1. Light beads are of the same
    material, of the radius that gives the mass ratio, so that all contacts are alike.
    """
    beads = whole("beads", beads, _LEAST, f"The force is read at contact {CONTACT}.")
    striker = float(positive("striker", striker, "It is the striker's velocity in m/s."))
    light = radius * RATIO ** (1 / 3)
    A, m = float(hertz_coefficient(material, radius, material, light)), float(bead_mass(material, radius))
    rate = (A * A * striker / (m * m)) ** 0.2
    lattice = bead_chain(material, [radius if n % 2 == 0 else light for n in range(beads)], boundary="free")
    run = simulate(lattice, impact(lattice, striker), _SLOWNESS * beads / rate, step=_STEP / rate, save_at=801,
                   record={"force": Peak(_force), "peak": Peak(_velocity)})
    attributes = {
        "rate": rate, "striker": striker, "ratio": RATIO, "radius_heavy": radius, "radius_light": light,
        "force_unit": A**0.4 * (m * striker**2) ** 0.6, "material": material, "solver": run.solver,
        "method": run.choice,
    }
    n = np.arange(beads)
    return xr.Dataset(
        {
            "velocity": (("time", "bead"), np.asarray(run.vs), {"units": "m/s"}),
            "peak": ("bead", np.asarray(run.recorded["peak"]), {"units": "m/s"}),
            "force": ("contact", np.asarray(run.recorded["force"]), {"units": "N"}),
        },
        {"time": ("time", np.asarray(run.ts), {"units": "s"}), "bead": n, "contact": n[:-1]},
        attributes,
    )


def _relative_force(data):
    return data["force"].values / (MONOMER_FORCE * data.attrs["force_unit"])


def transmitted_force(data: xr.Dataset) -> float:
    """Peak force of contact 100 over that of a monomer chain of the heavy beads."""
    return float(_relative_force(data)[CONTACT])


def heavy_peak(data: xr.Dataset) -> float:
    """Largest velocity of bead 40 over the striker's."""
    return float(data["peak"].values[HEAVY]) / data.attrs["striker"]


def light_peak(data: xr.Dataset) -> float:
    """Largest velocity of bead 41 over the striker's."""
    return float(data["peak"].values[LIGHT]) / data.attrs["striker"]


def _draw_map(plots, figure, data):
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    plots.space_time(
        data["velocity"].values, left, ts=1e3 * data["time"].values, sites=data["bead"].values, label="velocity",
        unit="m/s", time_label="time (ms)", site_label="bead", limit=0.6 * data.attrs["striker"],
    )
    left.set_title(rf"Velocity of every bead, $\varepsilon = {RATIO}$")
    # contacts that the pulse has passed
    force, n = _relative_force(data)[: CONTACT + 5], data["contact"].values[: CONTACT + 5]
    plots.profile(n[::2], force[::2], right, inset="none", x_label="contact", labels="heavy to light",
                  points=(n[1::2], force[1::2]), points_label="light to heavy", y_label="peak force / monomer's")
    right.axhline(0.3, color="0.55", lw=0.8)
    right.text(2, 0.28, "30 %", va="top", color="0.4")
    right.set_ylim(0, None)
    right.legend(frameon=False, loc="upper right")
    right.set_title("Peak contact force")


def _draw_beads(plots, figure, data, first, kind):
    ax = figure.subplots()
    until = data["time"].values * data.attrs["rate"] <= _HORIZON
    shown = np.arange(first, int(0.84 * _HORIZON) + 1, 8)
    plots.traces(1e3 * data["time"].values[until], data["velocity"].values[until], shown, ax, unit="m/s",
                 time_label="time (ms)", site_label="bead")
    ax.set_title(rf"{kind} beads, every fourth of them, $\varepsilon = {RATIO}$")


def _draw_heavy(plots, figure, data):
    _draw_beads(plots, figure, data, 4, "Heavy")


def _draw_light(plots, figure, data):
    _draw_beads(plots, figure, data, 5, "Light")


_CHOSEN = {
    "material": Choice("chrome steel", "", "of all beads; the light ones are smaller"),
    "radius": Choice(9.525e-3, "m", "of the heavy beads"),
    "striker": Choice(0.4, "m/s", "velocity of the striker, a heavy bead"),
    "beads": Choice(120, "", "number of beads, the striker included"),
}
_CAPTION = (
    "Simulation of the experiment: a heavy bead strikes a 1:1 dimer chain of mass ratio 0.59 without precompression; "
    "Hertz contacts, no friction, rotation or losses. Behind the pulse the motion is chaotic; from 100 on in "
    "units of A = m = v = 1 (2.9 ms here) its detail there depends on rounding, the pulse does not. "
)

FIGURES = (
    Figure(
        label="fig2.3",
        title="Space-time plot at the first resonance of a dimer chain",
        caption=_CAPTION + "The grey line is the review's bound, less than 30 %; what is below it here is the contact "
        "force, where the review speaks of the energy.",
        compute=compute,
        draw=_draw_map,
        number=transmitted_force,
        quantity=f"peak force of contact {CONTACT} / that of the monomer chain",
        expected=0.279756,
        tolerance=1e-4,
        source=_SOURCE + "; the review: less than 30 % of the energy makes it through",
        chosen=_CHOSEN,
        size=(9.2, 3.8),
    ),
    Figure(
        label="fig2.4",
        title="Velocities of the heavy beads at the first resonance",
        caption=_CAPTION,
        compute=compute,
        draw=_draw_heavy,
        number=heavy_peak,
        quantity=f"peak velocity of the heavy bead {HEAVY} / striker velocity",
        expected=0.426448,
        tolerance=1e-5,
        source=_SOURCE,
        chosen=_CHOSEN,
        size=(5.6, 4.6),
    ),
    Figure(
        label="fig2.5",
        title="Velocities of the light beads at the first resonance",
        caption=_CAPTION,
        compute=compute,
        draw=_draw_light,
        number=light_peak,
        quantity=f"peak velocity of the light bead {LIGHT} / striker velocity",
        expected=0.445059,
        tolerance=1e-5,
        source=_SOURCE,
        chosen=_CHOSEN,
        size=(5.6, 4.6),
    ),
)
