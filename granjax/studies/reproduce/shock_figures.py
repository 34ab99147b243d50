"""Figures DSW.1 to DSW.5: dispersive shocks of a granular chain, from a step and from a collision."""

from functools import lru_cache

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

from ...checks import positive, within
from ...lattice import Lattice
from ...laws import Hertz, taylor
from ...shocks import piston, space_time, step
from ...strains import Shift
from ...terms import Bond
from ...theory import kdv, toda
from ...theory.self_similar import ShockEdges
from ...types import Scalar
from .figure import Choice, Figure

# SciPy's DOP853 with its own right-hand side, at a relative and an absolute tolerance of 1e-12
HIGHEST, LENGTH, AMPLITUDE, CREST = 3.736772586, 4.592161032, 0.368775975, 1.037302677
_SOURCE = "independent integration by SciPy's DOP853 at 1e-12"
# of two simulations that agree to 2e-8, t = 2000 and 8000
PLATEAU = 0.19157239
# sites beyond what has moved; points between two bonds, phases of a turn, waves of a zoom
SPARE, FINE, PHASES, SHOWN = 60, 16, 360, 26
# of the map, and a time step
FRAMES, STEP = 160, 0.4
# T_f = 1200 in the slow time t eps^3/24, eps^2 = 24 c
TIME = 7746.0
# where DSW.2 looks: from the trailing edge to the leading one, and bonds to the sides; times before which no shock is
ZOOMS, ASIDE, EARLY = (0.17, 0.85), 14, 40.0
THEORIES = {"kdv": "KdV", "toda": "Toda"}


def _late(time):
    return float(within("time", time, EARLY, np.inf, open_high=True))


def _chain(law, sites):
    return Lattice(1.0, (Bond(Shift(1, "free"), law),), sites=sites, units="scaled")


def stepped(strain: Scalar, time: Scalar) -> xr.Dataset:
    """The strain after a step from `strain` to 0 in the review's chain, A = d0 = m = 1, and the edges of its shock."""
    return _stepped(float(positive("strain", strain)), _late(time)).copy()


@lru_cache(maxsize=1)
def _stepped(strain, time):
    law = Hertz(1.0, 1.0)
    sound = lambda y: float(law.derivative(y)) ** 0.5
    problem = step(_chain(law, 2 * (int(1.15 * sound(strain) * time) + SPARE)), strain)
    run = problem.run(time)
    y = np.asarray(problem.strain(run.final.u))
    places = np.arange(y.size) - float(problem.centre)
    crests = _crests(places, y)
    # between the fan, whose tail runs at the sound of the plateau, and the shock
    mean = y[(places > 0) & (places < 0.1 * time)].mean()
    edges = 2 * sound(0.0) - sound(mean), crests[0][-1] / time, mean, crests[1][-1]
    attributes = dict(zip(ShockEdges._fields, map(float, edges))) | {"time": time, "method": run.choice}
    return xr.Dataset({"strain": ("place", y)}, {"place": places}, attributes)


def _crests(places, y):
    """Places and heights of the crests right of the step, of a spline through the bonds; no ripple is one."""
    spline = CubicSpline(places, y)
    top = spline.derivative().roots(extrapolate=False)
    top = top[(spline(top, 2) < 0) & (top > 0) & (spline(top) > 0.3 * y[places > 0].max())]
    return top, spline(top)


def highest(data: xr.Dataset) -> float:
    """The largest strain of a bond ahead of the step."""
    return float(data["strain"].values[data["place"].values > 0].max())


def length(data: xr.Dataset) -> float:
    """Mean distance of the crests in the zoom at the leading edge."""
    crests = _crests(data["place"].values, data["strain"].values)[0]
    low, high = _windows(data)[1]
    return float(np.diff(crests[(crests > low) & (crests < high)]).mean())


def _windows(data):
    edges, time = _edges(data), data.attrs["time"]
    middles = [time * (edges.trailing_speed + x * (edges.leading_speed - edges.trailing_speed)) for x in ZOOMS]
    return [(n - ASIDE, n + ASIDE) for n in middles]


def _edges(data):
    return ShockEdges(*(data.attrs[name] for name in ShockEdges._fields))


def _draw_step(plots, figure, data):
    plots.shock(data["strain"].values, _edges(data), figure.subplots(), places=data["place"].values,
                time=data.attrs["time"], units="scaled")


def _draw_zooms(plots, figure, data):
    for ax, window, name in zip(figure.subplots(1, 2), _windows(data), ("trailing", "leading")):
        plots.shock_core(data["strain"].values, window, ax, places=data["place"].values, units="scaled")
        ax.set_title(f"Near the {name} edge")


def _granular(c, time):
    """A piston of speed 2c in a granular chain of sound 1 and K3 = 1/2, half of the velocity shock; K2, K3; edges."""
    law = Hertz(2 * 2**0.5 / 3, 1 / 3)
    K2, K3 = (float(x) for x in taylor(law)[:2])
    edges = {"kdv": kdv.velocity_shock(c, K2, K3), "toda": toda.velocity_shock(c)}
    # as long a chain for an early time: one program serves all
    sites = int(float(edges["toda"].leading_speed) * max(time, TIME)) + SPARE
    told = {f"{name}_{end}": float(x) for name, one in edges.items() for end, x in one._asdict().items()}
    return piston(_chain(law, sites), 2 * c), K2, K3, told | {"time": time}


def collided(c: Scalar, time: Scalar) -> xr.Dataset:
    """The strain of a velocity shock at a time, and the modulated waves of KdV and Toda at the place n = t."""
    return _collided(float(positive("c", c)), _late(time)).copy()


@lru_cache(maxsize=1)
def _collided(c, time):
    problem, K2, K3, attributes = _granular(c, time)
    # steps twice as long as the default leave errors below 1e-6
    run = problem.run(time, step=STEP)
    # the contact of the piston is the bond beside the step
    y = np.append(2 * c * time - float(run.final.u[0]), np.asarray(problem.strain(run.final.u)))
    places = np.arange(y.size) + 0.5
    zoom = np.abs(places - time) < SHOWN / 2
    fine = np.linspace(*places[zoom][[0, -1]], FINE * (zoom.sum() - 1) + 1)
    phases, found = 2 * np.pi * np.arange(PHASES) / PHASES, {}
    for name, wave in (("kdv", kdv.shock_wave(fine[:, None], time, c, K2, K3, phase=phases)),
                       ("toda", toda.shock_wave(fine[:, None], time, c, phase=phases))):
        strains = np.asarray(wave.strain)
        missed = np.sqrt(np.mean((strains[::FINE] - y[zoom, None]) ** 2, 0))
        best = missed.argmin()
        found |= {name: ("fine", strains[:, best]), f"{name}_phase": phases[best], f"{name}_missed": missed[best]}
    return xr.Dataset({"strain": ("place", y)} | found, {"place": places, "fine": fine},
                      attributes | {"method": run.choice})


def plateau(data: xr.Dataset) -> float:
    """Mean strain behind the shock, Hann-weighted over |n/t| < s_-/2."""
    x = data["place"].values / (data.attrs["toda_trailing_speed"] / 2 * data.attrs["time"])
    weight = np.where(x < 1, np.cos(np.pi * x / 2) ** 2, 0.0)
    return float(weight @ data["strain"].values / weight.sum())


def amplitude(data: xr.Dataset) -> float:
    """Height of the leading crest, of a spline through the bonds."""
    return float(_crests(data["place"].values, data["strain"].values)[1][-1])


def _draw_theory(name):
    def draw(plots, figure, data):
        whole, zoom = figure.subplots(1, 2, width_ratios=(1.5, 1))
        edges = ShockEdges(*(data.attrs[f"{name}_{end}"] for end in ShockEdges._fields))
        strain, options = data["strain"].values, {"places": data["place"].values, "units": "scaled"}
        plots.shock(strain, edges, whole, time=data.attrs["time"], **options)
        whole.set_title(f"Edges, mean and amplitude of {THEORIES[name]}", pad=8)
        window = data["fine"].values[[0, -1]] + [-0.5, 0.5]
        plots.shock_core(strain, window, zoom, beside={THEORIES[name]: (data["fine"].values, data[name].values)},
                         **options)
    return draw


def mapped(c: Scalar, time: Scalar) -> xr.Dataset:
    """The strain of every bond of a velocity shock at many times."""
    c, time = float(positive("c", c)), _late(time)
    problem, _, _, attributes = _granular(c, time)
    seen = space_time(problem, time, FRAMES, np.arange(int(1.25 * time)), step=STEP)
    return xr.Dataset({"strain": (("time", "place"), seen.strain)}, {"time": seen.ts, "place": seen.places}, attributes)


def crest_speed(data: xr.Dataset) -> float:
    """Place of the leading crest over time at the last time."""
    crests = _crests(data["place"].values, data["strain"].values[-1])[0]
    return float(crests[-1] / data["time"].values[-1])


def _draw_map(plots, figure, data):
    edges = {title: ShockEdges(*(data.attrs[f"{name}_{end}"] for end in ShockEdges._fields))
             for name, title in THEORIES.items()}
    plots.shock_map(data["strain"].values, figure.subplots(), edges=edges, ts=data["time"].values,
                    places=data["place"].values, units="scaled")


_STEP = {"strain": Choice(4.0, "", "strain left of the step, over the overlap at rest"),
         "time": Choice(150.0, "", "when it is looked at")}
_CHAIN = "Granular chain with precompression, scaled to the speed of sound 1 and K3 = 1/2, "
_SHOCK = {"c": Choice(0.1, "", "half the velocity of either side"),
          "time": Choice(TIME, "", "when it is looked at, T_f = 1200 of the slow time")}

FIGURES = (
    Figure(
        label="DSW.1", title="Dispersive shock from a step in the strain",
        caption="Granular chain, A = d0 = m = 1, at rest, with the strain 4 left of the step and 0 right of it: a "
        "rarefaction runs to the left, a dispersive shock to the right.",
        compute=stepped, draw=_draw_step, number=highest, quantity="largest strain of the shock", expected=HIGHEST,
        tolerance=1e-6, source=_SOURCE, chosen=_STEP, binding=("strain", "time"), size=(7.2, 3.8),
    ),
    Figure(
        label="DSW.2", title="Two zooms into the dispersive shock",
        caption="The shock of DSW.1 near its trailing and its leading edge: bonds (dots) and splines through them.",
        compute=stepped, draw=_draw_zooms, number=length, quantity="distance of crests near the leading edge [bonds]",
        expected=LENGTH, tolerance=1e-6, source=_SOURCE, chosen=_STEP, binding=("strain", "time"), size=(8.4, 3.4),
    ),
    Figure(
        label="DSW.3", title="Granular velocity shock and its KdV prediction",
        caption=f"{_CHAIN}after a velocity shock: edges of KdV, and its modulated wave at n = t, the phase fitted.",
        compute=collided, draw=_draw_theory("kdv"), number=plateau, quantity="mean strain of the plateau",
        expected=PLATEAU, tolerance=1e-6, source="converged simulations, t = 2000 and 8000, by another method",
        chosen=_SHOCK, binding=("c", "time"), size=(9.6, 3.8),
    ),
    Figure(
        label="DSW.4", title="Granular velocity shock and its Toda approximation",
        caption=f"{_CHAIN}after a velocity shock: edges of Toda, and its modulated wave at n = t, the phase fitted.",
        compute=collided, draw=_draw_theory("toda"), number=amplitude, quantity="height of the leading crest",
        expected=AMPLITUDE, tolerance=1e-6, source=_SOURCE, chosen=_SHOCK, binding=("c", "time"), size=(9.6, 3.8),
    ),
    Figure(
        label="DSW.5", title="Edges of the granular velocity shock, KdV and Toda",
        caption=f"{_CHAIN}after a velocity shock: the strain, and the edges of KdV (solid) and Toda (dashed).",
        compute=mapped, draw=_draw_map, number=crest_speed, quantity="place of the leading crest over time",
        expected=CREST, tolerance=1e-6, source=_SOURCE,
        chosen={"c": Choice(0.1, "", "half the velocity of either side"), "time": Choice(300.0, "", "last time shown")},
        binding=("c", "time"), size=(6.4, 4.4),
    ),
)
