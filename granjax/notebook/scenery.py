"""What the sliders move: scenes, their states, their runs."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import measures, states
from ..checks import described, refuse
from ..flow import Run, simulate
from ..flow.march import TAKES, seconds_a_step
from ..flow.run import TOO_MANY_STEPS
from ..flow.stiffness import frequency_bound, linear_frequency
from ..lattice import Lattice, State
from ..solvers import SRKN11b
from ..states.places import field_of
from ..units import SI
from .sliders import AMPLITUDE, PRECOMPRESSION, Movable, Slider

# seconds that the time steps of an update may take; more than what the first values ask for, in any case
BUDGET, ROOM = 0.1, 8
# a wave crosses so many sites in a radian of the highest frequency, at least
PACE = 0.25
# over the linear frequencies, what no wave reaches
FLOORLESS = 1e3
# h omega of the default step
STEP = 0.5
MAPS = {
    "v": "velocity",
    "u": "displacement",
    "force": "contact force",
    "strain": "strain",
    "energy": "energy",
}
MEASURES = {
    "force": measures.contact_force,
    "strain": measures.strain,
    "energy": measures.site_energy,
}
LEAST, MOST = 0.01, 10.0
TITLES = {"ratio": "mass ratio"}


class Shown(NamedTuple):
    """What stands in the map: the scene, its run, and the data (frames, places)."""

    lattice: Lattice
    state: State
    run: Run
    data: np.ndarray


class Scenery:
    """A scene that can be moved, and how it is run and shown; arguments as those of `explore`.

    `ranges`: the sliders by name, that of the amplitude included; `t1`: the end of the runs.
    """

    def __init__(
        self,
        scene: Movable,
        state: Any,
        t1: float | None,
        quantity: Any,
        frames: int,
        tolerance: Any,
    ):
        self._scene, self._state, self.t1 = scene, state, t1
        self._quantity, self._frames, self._tolerance = quantity, frames, tolerance
        self.ranges = dict(scene.sliders)
        self._most = None

    @property
    def label(self) -> str:
        """What is shown, in words."""
        if self._quantity in MAPS:
            return MAPS[self._quantity]
        name = getattr(self._quantity, "__name__", "").replace("_", " ").strip()
        return name if name and "<" not in name else "quantity"

    @property
    def place(self) -> str:
        """What the columns of the map are."""
        return "contact" if self._quantity in ("force", "strain") else "site"

    def title(self, name: str, counted: str | None) -> str:
        """What a slider is called, with the unit where somebody knows it; `counted`: "SI", or what else."""
        ours = name not in self._scene.names
        impact = ours and name == AMPLITUDE and self._state is None
        said = "impact velocity" if impact else TITLES.get(name, name.replace("_", " "))
        unit = "N" if name == PRECOMPRESSION else "m/s" if impact else ""
        return f"{said} ({unit})" if unit and counted == SI else said

    def begun(self) -> Shown:
        """The first run, which decides what was left open: the time, the most steps, what is much of a load."""
        values = {name: x.value for name, x in self.ranges.items()}
        lattice, state, paired = self._built(values)
        ours = AMPLITUDE not in self._scene.names
        if ours and not paired and AMPLITUDE not in {*self.ranges, *self._scene.fixed}:
            self.ranges[AMPLITUDE] = Slider(LEAST, MOST, 1.0, True)
        if ours and paired and AMPLITUDE in {*self.ranges, *self._scene.fixed}:
            refuse(
                AMPLITUDE,
                "none where the scene gives its state",
                "one",
                "Let the function take it.",
            )
        omega, linear = (
            float(frequency_bound(lattice, state, 0.0, 1.0)),
            float(linear_frequency(lattice)),
        )
        # of a law without a floor the bound says nothing
        omega = linear if linear > 0 and not omega < FLOORLESS * linear else omega
        if self.t1 is None:
            if not (omega > 0 and math.isfinite(omega)):
                refuse(
                    "t1",
                    "the end of the runs",
                    "None",
                    "No frequency of the scene at its start says it.",
                )
            sites = max(max(x.shape[: lattice.axes]) for x in jax.tree.leaves(lattice.zeros()))
            self.t1 = float(f"{sites / (PACE * omega):.2g}")
        each = seconds_a_step(lattice, SRKN11b(), TAKES)
        self._most = int(
            max(BUDGET / each, ROOM * self.t1 * omega / STEP if math.isfinite(omega) else 0, 1000)
        )
        shown = self.computed(values)
        for name, x in self.ranges.items():
            if math.isnan(x.high):
                forces = np.asarray(measures.along(measures.contact_force, lattice, shown.run))
                largest = np.abs(forces[np.isfinite(forces)]).max(initial=0.0)
                self.ranges[name] = x._replace(high=float(f"{largest:.1g}") if largest > 0 else 1.0)
        return shown

    def computed(self, values: dict[str, Any]) -> Shown:
        """The run of some values, and what is shown of it. **Raises** ValueError for what the scene refuses."""
        lattice, state, _ = self._built(values)
        run = simulate(
            lattice,
            state,
            self.t1,
            save_at=self._frames,
            tolerance=self._tolerance,
            throw=False,
            max_steps=self._most,
        )
        return Shown(lattice, state, run, self._data(lattice, run))

    def said(self, run: Run) -> str:
        """What became of a run, in a sentence."""
        if np.asarray(run.code) == TOO_MANY_STEPS:
            return (
                f"Stopped before t1 = {self.t1:.6g}: these values take more steps than a map that follows sliders "
                "can wait for. gx.simulate(explorer.lattice, explorer.state, t1) takes them all."
            )
        return run.outcome

    def _built(self, values):
        """Lattice, state, and whether the scene itself gave the state. Numbers are arrays: none compiles anew."""
        values = {name: jnp.asarray(x) if isinstance(x, float) else x for name, x in values.items()}
        values = self._scene.fixed | values
        amplitude = 1.0 if AMPLITUDE in self._scene.names else values.pop(AMPLITUDE, 1.0)
        lattice = self._scene.make(**values)
        paired = isinstance(lattice, (tuple, list)) and len(lattice) == 2
        lattice, state = lattice if paired else (lattice, None)
        if lattice.lanes:
            refuse(
                "scene",
                "one lattice at a time",
                f"one of {lattice.lanes} lanes",
                "A slider moves through them.",
            )
        if state is None and self._state is None:
            return lattice, states.impact(lattice, amplitude), False
        if state is None:
            state = self._state(lattice) if callable(self._state) else self._state
            state = jax.tree.map(lambda x: amplitude * jnp.asarray(x), State(*state))
        return lattice, State(*state), paired

    def _data(self, lattice, run):
        """What is shown of a run, (frames, places)."""
        if self._quantity in ("u", "v"):
            data, field = run.us if self._quantity == "u" else run.vs, field_of(lattice, None)
            data = data if field is None else data[field]
        else:
            own = self._quantity
            measure = MEASURES.get(own) or (lambda lattice, y, t: own(t, y, lattice))
            data = measures.along(measure, lattice, run)
        if not hasattr(data, "ndim") or data.ndim != 2:
            refuse(
                "quantity",
                "a number for each place on a line",
                f"{described(data)}",
                "Such as quantity=lambda t, y, lattice: y.v[:, 0].",
            )
        return np.asarray(data, float)
