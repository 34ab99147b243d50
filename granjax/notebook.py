"""In a notebook: sliders for the numbers of a scene, above a space-time map that follows them."""

import base64
import html
import inspect
import math
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from . import measures, states
from .checks import described, is_whole, one_of, positive, refuse, whole
from .flow import frequency_bound, linear_frequency, simulate
from .lattice import Lattice, State
from .plots import drawn, figure, space_time, style
from .types import Count, Quantity, Scalar, Scene, StateLike

INSTALL = "pip install 'granjax[notebook]'"
# label, what is counted, and the function of time, state and lattice
MAPS = {
    "v": ("velocity (m/s)", "site", lambda t, y, _: y.v),
    "u": ("displacement (m)", "site", lambda t, y, _: y.u),
    "force": ("contact force (N)", "contact", lambda t, y, x: measures.contact_force(x, y, t)),
    "strain": ("strain (m)", "contact", lambda t, y, x: measures.strain(x, y)),
    "energy": ("energy (J)", "site", lambda t, y, x: measures.site_energy(x, y, t)),
}
# of a slider whose ends are not given
LEAST_RATIO = 0.05
DECADE = 10.0
AMPLITUDES = ((0.01, 10.0, "log"), 1.0)
# sites that a wave crosses, about, in a radian of the highest frequency
PACE = 0.25
# over the linear frequencies, what no wave reaches: the bound of a law whose stiffness has none
FLOORLESS = 1e3
# an update may take this multiple of the steps of the first run
ROOM = 8
SIZE = (5.8, 4.3)


def explore(
    scene: Callable,
    t1: Scalar | None = None,
    *,
    state: StateLike | Scene | None = None,
    quantity: str | Quantity = "v",
    frames: Count = 240,
    **parameters: Any,
) -> "Explorer":
    r"""Sliders for the parameters of a scene, above a space-time map that follows them, in a notebook.

    A value that is refused, and a run that does not complete, say so below the map.

    **Arguments:**

    - `scene`: a function of named numbers that returns a `Lattice`, or a pair of it and a `State`, such as
      `gx.scenes.dimer` or a lambda.
    - `t1`: end of the runs; by default about what a wave takes to cross the lattice at first.
    - `state`: the start, whose displacements and velocities the slider `amplitude` multiplies: a `State`, or a function
      of the lattice. `None`: an impact on site 0, whose velocity is `amplitude`.
    - `quantity`: `"v"`, `"u"`, `"force"`, `"strain"`, `"energy"` (of each site), or a function `(t, y, lattice)` that
      returns a number for each place.
    - `frames`: rows of the map.
    - Parameters by name: `ratio=(0.1, 1.0)` is a slider, `load=(1, 1e3, "log")` one by the logarithm, whole numbers
      `sites=(20, 100)` one of whole numbers, which compiles once for each; any other value is fixed. What is not named
      has a slider where it is called `ratio` or `precompression`, and where a function of your own gives it a floating
      number.

    **Returns:** an `Explorer`, which a notebook shows; `.run`, `.lattice`, `.state`, `.values` are the present ones.
    **Raises** ImportError outside of a notebook and without ipywidgets, saying what to install; ValueError for names
    that the scene does not have, and for first values that it refuses.

    **Example:**

    >>> scene = lambda ratio=0.5: gx.scenes.dimer(20, ratio=ratio)
    >>> view = gx.explore(scene, 20.0, ratio=(0.1, 1.0))  # in a notebook  # doctest: +SKIP
    """
    widgets = _widgets()
    if callable(quantity):
        quantity = (getattr(quantity, "__name__", "quantity").strip("<>"), "place", quantity)
    else:
        quantity = MAPS[one_of("quantity", quantity, MAPS)]
    t1 = None if t1 is None else float(positive("t1", t1))
    return Explorer(widgets, scene, parameters, state, t1, quantity, whole("frames", frames, 2))


def _widgets():
    """The package ipywidgets, where a notebook shows it."""
    try:
        import ipywidgets
    except ImportError:
        raise ImportError(f"gx.explore needs ipywidgets. Install it: {INSTALL}.") from None
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(shell, "kernel", None) is None:
        how = f"Call it in Jupyter; {INSTALL} installs what it needs."
        raise ImportError(f"gx.explore needs a notebook. {how}")
    return ipywidgets


def _sliders(widgets, scene, given):
    """Sliders by name, and what is fixed, of the parameters of a function and those that were given."""
    found = inspect.signature(scene).parameters
    known = {name: p.default for name, p in found.items() if p.kind is not p.VAR_KEYWORD}
    own = not str(getattr(inspect.unwrap(scene), "__module__", "")).startswith("granjax.")
    if len(known) == len(found):
        for name in given:
            one_of("parameter", name, [*known, "amplitude"])
    sliders, fixed = {}, {}
    for name in dict.fromkeys([*known, *given]):
        default = known.get(name, inspect.Parameter.empty)
        number = default if isinstance(default, float) else None
        if isinstance(given.get(name), (tuple, list)):
            number = default if isinstance(default, (int, float)) else None
            ends = given[name]
        elif name in given:
            fixed[name] = given[name]
            continue
        elif name == "ratio":
            ends, number = (LEAST_RATIO, 1.0), number or 0.5
        elif name == "precompression":
            ends, number = (0.0, 4 * (number or 0.0) or 1.0), number or 0.0
        elif own and number is not None and number > 0:
            ends = (number / DECADE, number * DECADE, "log")
        elif default is inspect.Parameter.empty or own and number is not None:
            refuse(name, "a range or a value", "none", f"Such as {name}=(1.0, 10.0).")
        else:
            continue
        sliders[name] = _slider(widgets, name, ends, number)
    return sliders, fixed


def _slider(widgets, name, ends, value):
    """The slider of ipywidgets for a range, at a value or in its middle."""
    low, high, *log = ends
    if not (np.isfinite([low, high]).all() and low < high and (low > 0 or not log)):
        remedy = "A logarithmic slider begins above zero." if log else ""
        refuse(name, "two finite numbers, the lower one first", described(ends), remedy)
    counts = is_whole(low) and is_whole(high) and not log
    if value is None or not low <= value <= high:
        value = low if counts else math.sqrt(low * high) if log else (low + high) / 2
    told = {"value": value, "description": name.replace("_", " ")}
    told |= {"style": {"description_width": "160px"}, "layout": widgets.Layout(width="580px")}
    if counts and is_whole(value):
        return widgets.IntSlider(min=low, max=high, **told)
    if log:
        low, high = math.log10(low), math.log10(high)
    kind = widgets.FloatLogSlider if log else widgets.FloatSlider
    return kind(min=low, max=high, step=(high - low) / 200, **told)


class Explorer:
    """Sliders and a map. `gx.explore` makes one, and a notebook shows it as the last line of a cell.

    - `values`: the present values by name; `move(ratio=0.4)` sets some, as dragging does.
    - `lattice`, `state`, `run`: what is shown, for further work; `None` where the present values have no run.
    - `said`: the sentence below the map. `figure`: matplotlib's; `widget`: all of it, `sliders`: those of ipywidgets.
    """

    def __init__(
        self,
        widgets: Any,
        scene: Callable,
        parameters: dict,
        state: StateLike | Scene | None,
        t1: Scalar | None,
        quantity: tuple,
        frames: int,
    ):
        self._scene, self._start, self._quantity, self.t1 = scene, state, quantity, t1
        self._runs = {"save_at": frames, "throw": False}
        self.sliders, self._fixed = _sliders(widgets, scene, parameters)
        _, _, paired = self._built(self.values)
        if not paired and "amplitude" not in {*self.sliders, *self._fixed}:
            self.sliders["amplitude"] = _slider(widgets, "amplitude", *AMPLITUDES)
        self._compute(self.values)
        self._runs["max_steps"] = ROOM * max(int(np.max(self.run.stats["steps"])), 1000)
        self._line = widgets.HTML()
        shown = widgets.interactive_output(self._follow, self.sliders)
        self.widget = widgets.VBox([*self.sliders.values(), shown, self._line])

    @property
    def values(self) -> dict[str, float | int]:
        """The present values of the sliders, in the scene's units."""
        return {name: slider.value for name, slider in self.sliders.items()}

    def move(self, **values: Scalar) -> None:
        """Set some sliders. **Raises** ValueError for a slider that is not there, or a value beyond its ends."""
        for name, x in values.items():
            slider = self.sliders[one_of("slider", name, self.sliders)]
            base = getattr(slider, "base", None)
            low, high = (end if base is None else base**end for end in (slider.min, slider.max))
            if not low <= x <= high:
                refuse(name, f"a number from {low:.6g} to {high:.6g}", described(x))
            slider.value = x

    def __repr__(self) -> str:
        rows = [f"{name:<16}{x:.6g}" for name, x in self.values.items()]
        return "\n".join([*rows, f"{'t1':<16}{self.t1:.6g}", f"{'outcome':<16}{self.said}"])

    def _repr_mimebundle_(self, **options: Any) -> dict:
        bundle = self.widget._repr_mimebundle_(**options) or {}
        # for where a stored notebook is read without a kernel
        picture = base64.b64encode(drawn(self.figure, ".png", dpi=100)).decode()
        return bundle | {"text/plain": repr(self), "image/png": picture}

    def _built(self, values):
        """Lattice, state, and whether the scene itself gave the state. Numbers are arrays: none compiles anew."""
        values = {k: jnp.asarray(x) if isinstance(x, float) else x for k, x in values.items()}
        values = self._fixed | values
        known = inspect.signature(self._scene).parameters
        amplitude = 1.0 if "amplitude" in known else values.pop("amplitude", 1.0)
        lattice = self._scene(**values)
        if not isinstance(lattice, Lattice):
            lattice, state = lattice
            return lattice, State(*state), True
        if lattice.lanes:
            refuse("scene", "one lattice at a time", f"one of {lattice.lanes} lanes")
        if self._start is None:
            return lattice, states.impact(lattice, amplitude), False
        state = self._start(lattice) if callable(self._start) else self._start
        return lattice, jax.tree.map(lambda x: amplitude * jnp.asarray(x), State(*state)), False

    def _compute(self, values):
        """The run of some values. **Raises** ValueError for what the scene refuses."""
        self._at, self.lattice, self.state, self.run = values, None, None, None
        lattice, state, _ = self._built(values)
        if self.t1 is None:
            self.t1 = _crossing(lattice, state)
        run = simulate(lattice, state, self.t1, **self._runs)
        label, place, measure = self._quantity
        data = measures.along(lambda lattice, y, t: measure(t, y, lattice), lattice, run)
        if not hasattr(data, "ndim") or data.ndim != 2:
            remedy = "Such as quantity=lambda t, y, lattice: y.v[:, 0]."
            refuse("quantity", "a number for each place on a line", described(data), remedy)
        self.lattice, self.state, self.run, self.said = lattice, state, run, run.outcome
        # a run that stopped early has nothing for its last frames
        data = np.where(np.isfinite(data), data, np.nan)
        self.figure = figure(*SIZE)
        with style():
            ax, times = self.figure.subplots(), np.linspace(0.0, self.t1, len(data))
            space_time(run, ax, quantity=data, ts=times, label=label, site_label=place)

    def _follow(self, **values):
        """Compute what the sliders say and show it, or say why there is nothing to show."""
        from IPython.display import display

        try:
            # the first values have been computed before there were sliders
            if self.run is None or values != self._at:
                self._compute(values)
            display(self.figure)
        except Exception as error:  # whatever a user-defined scene raises for these values
            kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
            self.said = f"{kind}{error}"
        self._line.value = html.escape(self.said)


def _crossing(lattice, state):
    """About the time that a wave takes to cross a lattice."""
    omega = float(frequency_bound(lattice, state, 0.0, 1.0))
    linear = float(linear_frequency(lattice))
    omega = linear if linear > 0 and not omega < FLOORLESS * linear else omega
    if not (omega > 0 and math.isfinite(omega)):
        refuse("t1", "the end of the runs", "None", "No frequency of the scene says it.")
    sites = max(max(x.shape[: lattice.axes]) for x in jax.tree.leaves(lattice.zeros()))
    return float(f"{sites / (PACE * omega):.2g}")
