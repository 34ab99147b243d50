"""Notebook tools: sliders for the parameters of a scene with a live space-time map."""

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

from .. import measures, states
from ..base.checks import described, is_whole, one_of, positive, refuse, whole
from ..base.types import Count, Quantity, Scalar, Scene, StateLike
from ..flow import frequency_bound, linear_frequency, simulate
from ..lattice import Lattice, State
from . import drawn, figure, space_time, style

INSTALL = "pip install 'granjax[notebook]'"
# Label, label of the axis, and the function of time, state and lattice.
MAPS = {
    "v": ("velocity (m/s)", "site", lambda t, y, _: y.v),
    "u": ("displacement (m)", "site", lambda t, y, _: y.u),
    "force": ("contact force (N)", "contact", lambda t, y, x: measures.contact_force(x, y, t)),
    "strain": ("strain (m)", "contact", lambda t, y, x: measures.strain(x, y)),
    "energy": ("energy (J)", "site", lambda t, y, x: measures.site_energy(x, y, t)),
}
# The lower end of a slider `ratio` without given ends.
LEAST_RATIO = 0.05
# The factor from the default of another parameter to either end of its slider.
DECADE = 10.0
# The ends of the slider `amplitude`, and its first value.
AMPLITUDES = ((0.01, 10.0, "log"), 1.0)
# About the number of sites that a wave crosses in one radian of the highest frequency.
PACE = 0.25
# A frequency bound above this multiple of the linear frequencies comes from an unbounded stiffness.
FLOORLESS = 1e3
# An update may take this multiple of the steps of the first run.
ROOM = 8
# The width and the height of the map [inch].
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
    r"""Show sliders for the parameters of a scene, above a space-time map that follows them.

    Messages below the map report rejected values, and runs that do not complete.

    **Arguments:**

    - `scene`: a function of named numbers that returns a `Lattice`, or a pair of it and a `State`,
      such as `gx.scenes.dimer` or a lambda.
    - `t1`: end of the runs; by default about the time in which a wave first crosses the lattice.
    - `state`: the initial state, a `State` or a function of the lattice, multiplied by the slider
      `amplitude`. `None`: an impact on site 0 with velocity `amplitude`.
    - `quantity`: `"v"`, `"u"`, `"force"`, `"strain"`, `"energy"` (per site), or a function
      `(t, y, lattice)` that returns one number per site or contact.
    - `frames`: rows of the map.
    - Parameters by name: `ratio=(0.1, 1.0)` is a slider, `load=(1, 1e3, "log")` a logarithmic one,
      `sites=(20, 100)` one of integers, which compiles for each; other values are fixed. `ratio`,
      `precompression`, and floating numbers of your own function have sliders by default.

    **Returns:** an `Explorer`, which a notebook shows; `.run`, `.lattice`, `.state`, `.values` are
    the present ones. **Raises** ImportError outside a notebook or without ipywidgets; ValueError
    for unknown names, and for first values that the scene rejects.

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
    found = inspect.signature(scene).parameters
    known = {name: p.default for name, p in found.items() if p.kind is not p.VAR_KEYWORD}
    own = not str(getattr(inspect.unwrap(scene), "__module__", "")).startswith("granjax.")
    if len(known) == len(found):
        for name in given:
            one_of("parameter", name, [*known, "amplitude"])
    sliders = {}
    fixed = {}
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
            ends = (LEAST_RATIO, 1.0)
            number = number or 0.5
        elif name == "precompression":
            ends = (0.0, 4 * (number or 0.0) or 1.0)
            number = number or 0.0
        elif own and number is not None and number > 0:
            ends = (number / DECADE, number * DECADE, "log")
        elif default is inspect.Parameter.empty or own and number is not None:
            refuse(name, "a range or a value", "none", f"Such as {name}=(1.0, 10.0).")
        else:
            continue
        sliders[name] = _slider(widgets, name, ends, number)
    return sliders, fixed


def _slider(widgets, name, ends, value):
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
        low = math.log10(low)
        high = math.log10(high)
    kind = widgets.FloatLogSlider if log else widgets.FloatSlider
    return kind(min=low, max=high, step=(high - low) / 200, **told)


class Explorer:
    """Sliders and a map, made by `gx.explore` and shown as the last line of a notebook cell.

    - `values`: the present values by name; `move(ratio=0.4)` sets some, as dragging does.
    - `lattice`, `state`, `run`: those shown; `None` if the present values have no run.
    - `said`: the sentence below the map. `figure`: matplotlib's; `widget`: the whole, and
      `sliders`: of ipywidgets.
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
        self._scene = scene
        self._start = state
        self._quantity = quantity
        self.t1 = t1
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
        """Set some sliders. **Raises** ValueError for an unknown slider or a value out of range."""
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
        # A picture for readers of a stored notebook without a kernel.
        picture = base64.b64encode(drawn(self.figure, ".png", dpi=100)).decode()
        return bundle | {"text/plain": repr(self), "image/png": picture}

    def _built(self, values):
        # Lattice, state, and whether the scene gave the state; arrays avoid recompilation.
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
        self._at = values
        self.lattice = None
        self.state = None
        self.run = None
        lattice, state, _ = self._built(values)
        if self.t1 is None:
            self.t1 = _crossing(lattice, state)
        run = simulate(lattice, state, self.t1, **self._runs)
        label, place, measure = self._quantity
        data = measures.along(lambda lattice, y, t: measure(t, y, lattice), lattice, run)
        if not hasattr(data, "ndim") or data.ndim != 2:
            one = "[:, 0]" if hasattr(data, "ndim") else f"[{next(iter(data))!r}]"
            remedy = f"Such as quantity=lambda t, y, lattice: y.v{one}."
            refuse("quantity", "a number for each place on a line", described(data), remedy)
        self.lattice = lattice
        self.state = state
        self.run = run
        self.said = run.outcome
        # A run that stopped early has no values for its last frames.
        data = np.where(np.isfinite(data), data, np.nan)
        self.figure = figure(*SIZE)
        with style():
            ax = self.figure.subplots()
            times = np.linspace(0.0, self.t1, len(data))
            space_time(run, ax, quantity=data, ts=times, label=label, site_label=place)

    def _follow(self, **values):
        from IPython.display import display

        try:
            # The first values were computed before the sliders existed.
            if self.run is None or values != self._at:
                self._compute(values)
            display(self.figure)
        except Exception as error:  # whatever a user-defined scene raises for these values
            kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
            self.said = f"{kind}{error}"
        self._line.value = html.escape(self.said)


def _crossing(lattice, state):
    omega = float(frequency_bound(lattice, state, 0.0, 1.0))
    linear = float(linear_frequency(lattice))
    omega = linear if linear > 0 and not omega < FLOORLESS * linear else omega
    if not (omega > 0 and math.isfinite(omega)):
        refuse(
            "t1",
            "the end of the runs",
            "None",
            "The scene has no frequency from which one could be chosen.",
        )
    sites = max(max(x.shape[: lattice.axes]) for x in jax.tree.leaves(lattice.zeros()))
    return float(f"{sites / (PACE * omega):.2g}")
