"""`explore`: sliders above a space-time map that follows them."""

import base64
import html
import io
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from PIL import Image

from ..checks import described, one_of, positive, refuse, show, whole
from ..flow import Run
from ..lattice import Lattice, State
from ..plots import figure, space_time, style
from ..plots.histories import colours_of
from ..plots.quantities import Axis, drawn_in
from ..types import Count, Quantity, Scalar, Scene, StateLike
from ..units import UnitsOrWords
from .scenery import MAPS, Scenery, Shown
from .sliders import movable

INSTALL = "pip install 'granjax[notebook]'"
# what a function of the user's may raise for the values of its sliders
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    NameError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
# steps of a slider, about; size of the picture [inch], dots per inch; how much is seen of a map that is out of date
STEPS, SIZE, DOTS, FADED = (100, 301), (5.8, 4.3), 100, 0.25


def explore(
    scene: Lattice | Callable,
    t1: Scalar | None = None,
    *,
    state: StateLike | Scene | None = None,
    quantity: str | Quantity = "v",
    frames: Count = 240,
    tolerance: Scalar | None = None,
    units: UnitsOrWords = None,
    **parameters: Any,
) -> "Explorer":
    r"""Sliders for the parameters of a scene, above a space-time map that follows them, in a notebook.

    What is moved is computed anew at once, by the programs that were compiled for the first values: 100 beads take some
    ms, and drawing about 40. A value that is refused, and a run that does not complete, say so below the map.

    **Arguments:**

    - `scene`: a function of named numbers that returns a `Lattice`, or a pair of it and a `State`, such as
      `gx.scenes.dimer` or a lambda; or a `Lattice`, whose precompression and mass ratio (where its masses take two
      values) are moved.
    - `t1`: end of the runs; by default about what a wave takes to cross the lattice at first.
    - `state`: the start, whose displacements and velocities the slider `amplitude` multiplies: a `State`, or a function
      of the lattice. `None`: an impact on site 0, whose velocity is `amplitude`.
    - `quantity`: `"v"`, `"u"`, `"force"`, `"strain"`, `"energy"` (of each site), or a function `(t, y, lattice)` that
      returns a number for each place.
    - `frames`: rows of the map. `tolerance`, `units`: as in `simulate` and in `granjax.plots`.
    - Parameters by name: `ratio=(0.1, 1.0)` is a slider, `load=(1, 1e3, "log")` one by the logarithm, any other value
      is fixed, `sites=100`. What is not named has a slider where the function gives no value, where it is called
      `ratio` or `precompression`, and in functions of your own wherever it is a floating number.

    Numbers of a slider are in the scene's units. Whole numbers, such as `sites=(20, 100)`, compile once for each value.

    **Returns:** an `Explorer`, which a notebook shows; `.run`, `.lattice`, `.state`, `.values` are the present ones.
    **Raises** ImportError outside of a notebook and without ipywidgets, saying what to install; ValueError for names
    that the scene does not have, and for first values that it refuses.

    **Example:**

    >>> scene = lambda ratio=0.5: gx.scenes.dimer(20, ratio=ratio)
    >>> scene(ratio=0.3).shape
    (20,)
    >>> view = gx.explore(scene, 20.0, ratio=(0.1, 1.0))  # in a notebook  # doctest: +SKIP
    """
    if not callable(quantity):
        one_of("quantity", quantity, MAPS)
    t1 = None if t1 is None else float(positive("t1", t1))
    scenery = Scenery(
        movable(scene, parameters), state, t1, quantity, whole("frames", frames, 2), tolerance
    )
    return Explorer(scenery, units, _widgets())


def _widgets():
    """The package ipywidgets, where a notebook shows it."""
    try:
        import ipywidgets
    except ImportError:
        raise ImportError(
            f"gx.explore: expected ipywidgets, got none. Install it: {INSTALL}."
        ) from None
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(shell, "kernel", None) is None:
        raise ImportError(
            "gx.explore: expected a notebook, got Python without one. Call it in Jupyter, or in another "
            f"front end of notebooks; {INSTALL} installs what it needs."
        )
    return ipywidgets


class Explorer:
    """Sliders and a map. `gx.explore` makes one, and a notebook shows it as the last line of a cell.

    - `values`: the present values by name; `move(ratio=0.4)` sets some, as dragging does.
    - `lattice`, `state`, `run`: what is shown, for further work. RuntimeError where the present values have no run.
    - `said`: the sentence below the map. `seconds`: what the last update took, to compute and to draw.
    - `figure`: matplotlib's, `image` the map in it; `widget`: all of it, `sliders`: those of ipywidgets by name.
    """

    def __init__(self, scenery: Scenery, units: UnitsOrWords, widgets: Any):
        self._scenery, self._units, self._signed, self._held = scenery, units, False, False
        self.seconds = {"compute": 0.0, "draw": 0.0}
        self._shown = scenery.begun()
        self._refused = ""
        self._draw()
        self.sliders = {name: self._slider(widgets, name) for name in scenery.ranges}
        self._picture = widgets.Image(
            format="png", layout=widgets.Layout(width="580px", max_width="100%")
        )
        self._line = widgets.HTML()
        self.widget = widgets.VBox([*self.sliders.values(), self._picture, self._line])
        self._update()

    @property
    def values(self) -> dict[str, float | int]:
        """The present values of the sliders, in the scene's units."""
        return {name: slider.value for name, slider in self.sliders.items()}

    def move(self, **values: Scalar) -> None:
        """Set some sliders at once. **Raises** ValueError for a slider that is not there, a value beyond its ends."""
        for name, x in values.items():
            span = self._scenery.ranges[one_of("slider", name, self.sliders)]
            if not span.low <= x <= span.high:
                refuse(name, f"a number from {show(span.low)} to {show(span.high)}", described(x))
        self._held = True
        try:
            for name, x in values.items():
                self.sliders[name].value = int(x) if self._scenery.ranges[name].whole else float(x)
        finally:
            self._held = False
        self._update()

    @property
    def lattice(self) -> Lattice:
        """The present lattice."""
        return self._present().lattice

    @property
    def state(self) -> State:
        """The state that the present run began with."""
        return self._present().state

    @property
    def run(self) -> Run:
        """The present run, with the frames of the map."""
        return self._present().run

    def _present(self) -> Shown:
        if self._refused:
            raise RuntimeError(f"The present values have no run. {self._refused}")
        return self._shown

    @property
    def said(self) -> str:
        """What became of the present values, in a sentence."""
        return self._refused or self._scenery.said(self._shown.run)

    def __repr__(self) -> str:
        ranges = self._scenery.ranges
        rows = [
            (self._title(name), f"{x:.6g}, from {ranges[name].low:.6g} to {ranges[name].high:.6g}")
            for name, x in self.values.items()
        ]
        rows += [("t1", f"{self._scenery.t1:.6g}"), ("outcome", self.said)]
        width = 1 + max(15, *(len(name) for name, _ in rows))
        return "\n".join(f"{name:<{width}}{value}" for name, value in rows)

    def _repr_mimebundle_(self, **options: Any) -> dict:
        bundle = self.widget._repr_mimebundle_(**options) or {}
        # for where a stored notebook is read without a kernel
        picture = base64.b64encode(self._picture.value).decode()
        return bundle | {"text/plain": repr(self), "image/png": picture}

    def _title(self, name):
        return self._scenery.title(name, self._shown.lattice.units)

    def _slider(self, widgets, name):
        span = self._scenery.ranges[name]
        told = {
            "description": self._title(name),
            "continuous_update": True,
            "style": {"description_width": "180px"},
            "layout": widgets.Layout(width="580px", max_width="100%"),
        }
        if span.whole:
            made = widgets.IntSlider(value=span.value, min=span.low, max=span.high, **told)
        elif span.log:
            low, high, value = map(math.log10, (span.low, span.high, span.value))
            made = widgets.FloatLogSlider(
                value=span.value,
                min=low,
                max=high,
                step=_step(low, high, value),
                readout_format=".3g",
                **told,
            )
        else:
            made = widgets.FloatSlider(
                value=span.value,
                min=span.low,
                max=span.high,
                readout_format=".3g",
                step=_step(span.low, span.high, span.value),
                **told,
            )
        made.observe(self._moved, names="value")
        return made

    def _moved(self, change):
        if not self._held:
            self._update()

    def _update(self):
        """Compute what the sliders say, and show it, or say why there is nothing to show."""
        begin = time.perf_counter()
        try:
            self._shown, self._refused = self._scenery.computed(self.values), ""
        except FAILURES as error:
            kind = (
                "" if isinstance(error, (RuntimeError, ValueError)) else f"{type(error).__name__}: "
            )
            self._refused = f"{kind}{error}"
        computed = time.perf_counter()
        self._redraw()
        self._picture.value = self._drawn()
        self._line.value = html.escape(self.said)
        self.seconds = {"compute": computed - begin, "draw": time.perf_counter() - computed}

    def _draw(self):
        """The figure, once: all later ones are its image with other data."""
        self.figure = figure(*SIZE)
        with style():
            axes = self.figure.subplots()
            run, data = self._shown.run, self._shown.data
            # even in float32 too
            times = np.linspace(0.0, self._scenery.t1, len(data))
            space_time(
                run,
                axes,
                quantity=data,
                ts=times,
                label=self._scenery.label,
                units=self._units,
                site_label=self._scenery.place,
            )
        self.image = axes.images[0]
        # numbers beside the colours may grow longer than the first ones
        self.figure.get_layout_engine().set(rect=(0.01, 0.005, 0.94, 0.99))
        self.figure.set_dpi(DOTS)
        self.figure.canvas.draw()
        self.figure.set_layout_engine("none")

    def _redraw(self):
        if self._refused:
            self.image.set_alpha(FADED)
            return
        run, data = (
            self._shown.run,
            np.where(np.isfinite(self._shown.data), self._shown.data, np.nan),
        )
        top = float(np.nanmax(np.abs(data), initial=0.0)) or 1.0
        # a map of both signs remains one
        norm, colours = colours_of(data, top)
        self._signed |= isinstance(norm, TwoSlopeNorm)
        _, by = drawn_in(
            self._units, run.units, Axis("time", np.asarray(run.ts)), Axis(self._scenery.label, top)
        )
        factor = by.factor
        norm, colours = colours_of(
            factor * (np.array([[-top, top]]) if self._signed else data), factor * top
        )
        _, _, bottom, end = self.image.get_extent()
        self.image.set(
            data=data * factor,
            norm=norm,
            cmap=colours,
            alpha=1.0,
            extent=(-0.5, data.shape[1] - 0.5, bottom, end),
        )
        self.image.colorbar.ax.yaxis.label.set_text(by.label)

    def _drawn(self):
        """The picture, as the content of a PNG file."""
        self.figure.canvas.draw()
        content = io.BytesIO()
        Image.fromarray(np.asarray(self.figure.canvas.buffer_rgba())[..., :3]).save(
            content, "png", compress_level=1
        )
        return content.getvalue()


def _step(low, high, value):
    """The step of a slider on whose grid the first value lies, which a front end would else round."""
    share = (value - low) / (high - low)
    count = min(
        range(*STEPS), key=lambda n: (round(abs(share * n - round(share * n)), 6), abs(n - 200))
    )
    return (high - low) / count
