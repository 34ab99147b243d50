"""Figures 2.3 to 2.5: the first resonance of a dimer chain, as a laser vibrometer would see it."""

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from ...checks import positive, whole
from ...flow import Peak, Run, simulate
from ...lattice import Lattice, spread_mass
from ...materials import bead_mass, hertz_coefficient
from ...measures import contact_force
from ...scenes import beads as bead_chain
from ...states import impact
from ...types import Count, Scalar
from .figure import Choice, Figure

# the review's first resonance, light over heavy
RATIO = 0.59
CONTACT, HEAVY, LIGHT = 99, 40, 41
_LEAST = 110
# time per bead that the slowing front needs, and step, in units of A = m = v = 1
_SLOWNESS, _STEP = 1.17, 0.05
# frames that are kept, and times between them at which energies are looked at
_FRAMES, _BETWEEN = 800, 4
# of a contact's largest force, above which it counts as closed
_CLOSED = 1e-9
# later the motion behind the pulse depends on rounding: integrators part by a tenth of the striker's velocity at 120
_HORIZON = 100
_SOURCE = "SciPy's DOP853, relative tolerances 1e-10 and 1e-12 agreeing to 1e-7"


def _force(t, y, lattice):
    return contact_force(lattice, y)


def _velocity(t, y, lattice):
    return y.v


def compute(material: str, radius: Scalar, striker: Scalar, beads: Count) -> xr.Dataset:
    """Velocities [m/s], peak contact forces [N] and the energy that the pulse carries past contacts [J].

    A chain of heavy and light spheres in turn, struck at its end. Bead 0 is the striker, a heavy bead; contact n lies
    between the beads n and n + 1. Light beads are of the same material, of the radius that gives the mass ratio, so
    that all contacts are alike.
    """
    beads = whole("beads", beads, _LEAST, f"The energy is read at contact {CONTACT}.")
    striker = float(positive("striker", striker, "It is the striker's velocity in m/s."))
    light = radius * RATIO ** (1 / 3)
    A, m = float(hertz_coefficient(material, radius, material, light)), float(bead_mass(material, radius))
    rate = (A * A * striker / (m * m)) ** 0.2
    lattice = bead_chain(material, [radius if n % 2 == 0 else light for n in range(beads)], boundary="free")
    run = simulate(lattice, impact(lattice, striker), _SLOWNESS * beads / rate, step=_STEP / rate,
                   save_at=_FRAMES * _BETWEEN + 1, record={"force": Peak(_force), "peak": Peak(_velocity)})
    attributes = {
        "rate": rate, "striker": striker, "striker_energy": m * striker**2 / 2,
        "ratio": RATIO, "radius_heavy": radius, "radius_light": light,
        "force_unit": A**0.4 * (m * striker**2) ** 0.6, "material": material, "solver": run.solver,
        "method": run.choice,
    }
    n = np.arange(beads)
    return xr.Dataset(
        {
            "velocity": (("time", "bead"), np.asarray(run.vs)[::_BETWEEN], {"units": "m/s"}),
            "peak": ("bead", np.asarray(run.recorded["peak"]), {"units": "m/s"}),
            "force": ("contact", np.asarray(run.recorded["force"]), {"units": "N"}),
            "passed": ("contact", passed_energy(lattice, run), {"units": "J"}),
        },
        {"time": ("time", np.asarray(run.ts)[::_BETWEEN], {"units": "s"}), "bead": n, "contact": n[:-1]},
        attributes,
    )


def passed_energy(lattice: Lattice, run: Run) -> Float[np.ndarray, " contacts"]:
    """The energy that the leading pulse carries past each contact of a chain with free ends, (N - 1,) [J].

    All that lies beyond the contact where its force, after its first peak, is smallest: zero where it opens. Between
    frames by the force's parabola and the flux F v there. NaN where the run ends before.
    """
    bond = lattice.terms[0]
    looked_at = jax.vmap(lambda u: (bond.law.force(bond.strain_map.strain(u)), bond.energy(0.0, u)), out_axes=-1)
    force, potential = map(np.asarray, looked_at(run.us))
    v, gap = np.asarray(run.vs).T, float(run.ts[1] - run.ts[0])
    kinetic = np.asarray(spread_mass(lattice))[:, None] * v**2 / 2
    sites = kinetic[1:] + np.concatenate([potential[1:], np.zeros((1, len(run.ts)))])
    beyond = np.cumsum(sites[::-1], 0)[::-1]
    passed = np.full(len(force), np.nan)
    for n, F in enumerate(force):
        start = np.argmax(F > _CLOSED * F.max())
        top = start + np.argmax(np.diff(F[start:]) < 0)
        rises = (np.diff(F[top:]) >= 0) & (F[top:-1] < F[top])
        if rises.any():
            k = top + np.argmax(rises)
            before, here, after = F[k - 1 : k + 2]
            curve = before - 2 * here + after
            later = gap * (before - after) / (2 * curve) if here > 0 and curve > 0 else 0.0
            passed[n] = beyond[n, k] + here * v[n + 1, k] * later
    return passed


def _passed_share(data):
    """Contacts from a light to a heavy bead as far as the number's, and the share of the striker's energy there."""
    n = data["contact"].values[1 : CONTACT + 1 : 2]
    return n, data["passed"].values[n] / data.attrs["striker_energy"]


def transmitted_energy(data: xr.Dataset) -> float:
    """Energy that the leading pulse carries past contact 99 over the striker's."""
    return float(_passed_share(data)[1][-1])


def heavy_peak(data: xr.Dataset) -> float:
    """Largest velocity of bead 40 over the striker's."""
    return float(data["peak"].values[HEAVY]) / data.attrs["striker"]


def light_peak(data: xr.Dataset) -> float:
    """Largest velocity of bead 41 over the striker's."""
    return float(data["peak"].values[LIGHT]) / data.attrs["striker"]


def _draw_map(plots, figure, data):
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    plots.space_time(
        data["velocity"].values, left, ts=data["time"].values, sites=data["bead"].values, label="velocity",
        units=("ms", "m/s"), site_label="bead", limit=0.6 * data.attrs["striker"],
    )
    left.set_title(rf"Velocity of every bead, $\varepsilon = {RATIO}$")
    plots.profile(*_passed_share(data), right, inset="none", x_label="contact, light to heavy bead",
                  y_label="energy / striker's")
    right.axhline(0.3, color="0.55", lw=0.8)
    right.text(2, 0.28, "30 %", va="top", color="0.4")
    right.set_ylim(0, None)
    right.set_title("Energy that the leading pulse carries on")


def _draw_beads(plots, figure, data, first, kind):
    ax = figure.subplots()
    until = data["time"].values * data.attrs["rate"] <= _HORIZON
    shown = np.arange(first, int(0.84 * _HORIZON) + 1, 8)
    plots.traces(data["time"].values[until], data["velocity"].values[until], shown, ax, units=("ms", "m/s"),
                 label="velocity", site_label="bead")
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
        caption=_CAPTION + "Right: the energy beyond a contact when the leading pulse has passed it, at the first "
        "minimum of the contact's force; the grey line is the review's bound, less than 30 % of the initial energy.",
        compute=compute,
        draw=_draw_map,
        number=transmitted_energy,
        quantity=f"energy that the leading pulse carries past contact {CONTACT} / the striker's",
        expected=0.068545,
        tolerance=1e-5,
        source=_SOURCE + "; the review: less than 30 % of the initial energy makes it through",
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
