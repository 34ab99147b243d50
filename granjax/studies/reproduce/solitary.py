"""Figures 1.2 and 1.3: the exact solitary wave of the Hertz chain beside both compactons, and how it runs."""

import numpy as np
import xarray as xr

from ...checks import whole
from ...flow import Arrival, simulate
from ...laws import Hertz
from ...measures import along, strain
from ...scenes import monomer
from ...theory import compacton
from ...travelling import solitary_wave
from ...types import Count
from .figure import Choice, Figure

POINTS, AHEAD = 32, 12
TOLERANCE = 1e-11


def _strain(t, y, lattice):
    return strain(lattice, y)


def compute(sites: Count, travel: Count) -> xr.Dataset:
    """The wave at contact 12 of a chain at rest, and `travel` contacts later."""
    travel = whole("travel", travel, 2, "It is how many contacts the wave runs.")
    sites = whole("sites", sites, travel + 2 * AHEAD, f"The wave needs {AHEAD} contacts before it and behind.")
    wave = solitary_wave(Hertz(), speed=1.0)
    lattice = monomer(sites, boundary="free")
    state = wave.state(sites, centre=AHEAD)
    half = float(wave.strain(0.5))
    place = np.linspace(-6, 6, 12 * POINTS + 1)
    run = simulate(lattice, state, float(travel), tolerance=TOLERANCE, save_at=4 * travel + 1,
                   record={"arrival": Arrival(_strain, half)})
    strains = np.asarray(along(strain, lattice, run))
    return xr.Dataset(
        {
            "strain": (("time", "contact"), strains),
            "arrival": ("contact", np.asarray(run.recorded["arrival"])),
            "exact": ("place", np.asarray(wave.strain(place))),
        },
        {"time": np.asarray(run.ts), "contact": np.arange(sites - 1), "place": place},
        {"start": AHEAD, "travel": travel, "units": "scaled: A = m = 1", "solver": run.solver, "method": run.choice},
    )


def speed(data: xr.Dataset) -> float:
    """Contacts per time, from the line through the times at which contacts reach the strain phi(1/2)."""
    n = np.arange(AHEAD + 1, AHEAD + data.attrs["travel"])
    return float(1 / np.polyfit(n, data["arrival"].values[n], 1)[0])


def _draw(plots, figure, data):
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
    plots.space_time(data["strain"].values, left, ts=data["time"].values, sites=data["contact"].values,
                     label="strain", site_label="contact $n$", units="scaled")
    left.set_title("Strain of every contact")
    end = data.attrs["start"] + data.attrs["travel"]
    near = np.abs(data["contact"].values - end) <= 6
    plots.profile(
        data["place"].values, data["exact"].values, right, labels="exact",
        points=(data["contact"].values[near] - end, data["strain"].values[-1, near]),
        points_label=f"simulated, $t = {data.attrs['travel']}$", floor=1e-12,
        x_label=r"$\xi = n - n_0 - c\,t$", y_label="strain", units="scaled",
    )
    right.set_title(f"Profile after {data.attrs['travel']} contacts")


def profile(speed: float, reach: int) -> xr.Dataset:
    """The exact wave, its slope and both compactons at places xi = n - c t; its residual and error."""
    reach = whole("reach", reach, 3, "It is how many contacts are shown on each side.")
    wave = solitary_wave(Hertz(), speed=speed)
    xi = np.linspace(-reach, reach, 2 * reach * POINTS + 1)
    velocity = np.asarray(wave.velocity(np.append(xi, xi[-POINTS:] + 1)))
    slope = (velocity[POINTS:] - velocity[:-POINTS]) / speed
    forms = {"nesterenko": compacton.nesterenko, "ahnert_pikovsky": compacton.ahnert_pikovsky}
    return xr.Dataset(
        {
            "strain": ("place", np.asarray(wave.strain(xi))), "slope": ("place", slope),
            **{name: ("place", np.asarray(form(xi, speed=speed).strain)) for name, form in forms.items()},
        },
        {"place": xi},
        {"speed": float(speed), "units": "scaled: A = m = 1", "error": float(wave.error),
         "residual": float(wave.residual)},
    )


def peak(data: xr.Dataset) -> float:
    """The peak strain over c^4."""
    return float(data["strain"].sel(place=0.0) / data.attrs["speed"] ** 4)


def _draw_profile(plots, figure, data):
    ax = figure.subplots()
    xi, strain = data["place"].values, data["strain"].values
    curves = {"exact": strain, "its slope": data["slope"].values, "Nesterenko": data["nesterenko"].values,
              "Ahnert-Pikovsky": data["ahnert_pikovsky"].values}
    at = np.arange(0, len(xi), POINTS)
    plots.profile(xi, np.stack(list(curves.values()), -1), ax, labels=list(curves), points=(xi[at], strain[at]),
                  points_label="lattice", floor=1e-30, x_label=r"$\xi = n - c\,t$", y_label="strain", units="scaled")


FIGURES = (
    Figure(
        label="fig1.2",
        title="The travelling wave's profile, its derivative and its tail",
        caption="The exact wave of a Hertz chain without precompression (A = m = 1), its slope, the lattice's "
        "contacts, and both compactons, which end where the wave's tail goes on doubly exponentially (inset).",
        compute=profile,
        draw=_draw_profile,
        number=peak,
        quantity="peak strain over c^4",
        expected=1.48735937434940207,
        tolerance=1e-13,
        source="the same equation by two other methods",
        chosen={
            "speed": Choice(1.0, "", "speed of the wave, contacts per time"),
            "reach": Choice(6, "", "contacts shown on each side"),
        },
        size=(6.4, 4.4),
    ),
    Figure(
        label="fig1.3",
        title="Space-time evolution of the exact travelling wave, strain, c = 1",
        caption="The fixed point of phi = tent * phi^(3/2) set on a Hertz chain without precompression (A = m = 1), "
        "and its profile after it has run along the chain.",
        compute=compute,
        draw=_draw,
        number=speed,
        quantity="speed of the wave [contacts/time]",
        expected=1.0,
        tolerance=1e-9,
        source="the speed that the profile was computed for",
        chosen={
            "sites": Choice(90, "", "beads of the chain"),
            "travel": Choice(60, "", "contacts that the wave runs"),
        },
        size=(9.2, 3.8),
    ),
)
