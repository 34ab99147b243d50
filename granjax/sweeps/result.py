"""`Sweep`: what a sweep has found, an `xarray.Dataset` by the names of the parameters."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from ..checks import one_of, refuse
from ..entry import checked
from ..files import save
from ..flow import Run, simulate
from ..flow.lifted import scene_of
from ..printing import brief, called, numbers
from ..types import Count, Scalar
from . import function as own
from .points import Points
from .table import table

# relative distance within which a number is that of a lane
SAME = 1e-9


@dataclass(frozen=True, repr=False)
class Scene:
    """What a lane of a sweep runs: `lattice`, `state`, `t1`, and the `keywords` that the function gave to `simulate`.

    It unpacks as (lattice, state); `run` makes the run, with a trajectory where that is asked for.

    **Example:**

    >>> def pulse(ratio):
    ...     chain = gx.scenes.dimer(20, ratio=ratio)
    ...     return {"v": gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05).final.v[0]}
    >>> scene = gx.sweep(pulse, {"ratio": [0.5, 1.0]}).scene(ratio=0.5)
    >>> scene.lattice.shape, scene.t1, scene.keywords["step"]
    ((20,), 5.0, 0.05)
    """

    lattice: Any
    state: Any
    t1: Any
    keywords: dict[str, Any]

    def __iter__(self) -> Iterator[Any]:
        return iter((self.lattice, self.state))

    def __repr__(self) -> str:
        given = {name: x for name, x in self.keywords.items() if x not in (None, False, 0.0)}
        return called("Scene", {"lattice": brief(self.lattice), "t1": self.t1, **given})

    @checked
    def run(self, t1: Scalar | None = None, **keywords: Any) -> Run:
        """The run, by `gx.simulate`; other times and keywords than the function's own may be given, `save_at=400`."""
        given = {name: x for name, x in {**self.keywords, **keywords}.items() if x is not None}
        return simulate(self.lattice, self.state, self.t1 if t1 is None else t1, **given)


class Sweep(xarray.Dataset):
    """What `gx.sweep` returns: an `xarray.Dataset` whose axes are the parameters.

    - Coordinates: the parameters by their names, along an axis each (a grid) or all along `lane` (a list), with units.
    - Variables: what the function returned, by its names; axes of its own follow. NaN, or "", where a lane failed.
    - `reason`: for each lane that failed, or gave what is not finite, a sentence; "" for all others.
    - Attributes: `outcome`; the versions, the commit, how to cite; the function and its parameters (`sweep`).

    What xarray makes of it (`.sel`, `.mean`) is one too, but no longer knows the function.

    **Example:**

    >>> data = gx.sweep(lambda x: {"y": x**2}, {"x": [1.0, 2.0, 3.0]})
    >>> data.outcome, float(data.y.sel(x=3.0))
    ('3 lanes over x (3).', 9.0)
    """

    __slots__ = ("_function", "_points")

    @property
    def outcome(self) -> str:
        """What became of it, in a sentence."""
        return str(self.attrs.get("outcome", ""))

    def _known(self):
        points = getattr(self, "_points", None)
        if points is None or self._function is None:
            refuse("sweep", "what gx.sweep returned", "one that was read, or made of another by xarray",
                   "Its function is not known: call it by yourself.")
        return self._function, points

    @checked
    def scene(self, **parameters: Any) -> Scene:
        """What the function ran at these parameters: `sweep.scene(ratio=0.59).run(save_at=400)` is its trajectory.

        A parameter may be any value, not only one of the sweep's; one that has a single value may be left out.
        The default step is that of the lane alone, a chunk of lanes had that of its stiffest one.

        **Returns:** `Scene`, of the first run that the function asks for. **Raises** ValueError for parameters that
        the sweep has not, or where the function runs nothing.
        """
        function, points = self._known()
        for name in parameters:
            one_of("parameter", name, tuple(points.axes))
        values = {}
        for name, x in points.axes.items():
            if name not in parameters and len(np.unique(x)) > 1:
                refuse(name, "a value of each parameter", "none", f"The sweep has {numbers(x)}.")
            values[name] = _nearest(x, parameters.get(name, x[0].item()))
        scene = scene_of(own.call, function, values, own.by_keywords(function, tuple(points.axes)))
        if scene is None:
            refuse("sweep", "one whose function calls gx.simulate", f"{own.name_of(function)}, which does not")
        return Scene(*scene)

    @checked
    def table(self, rows: Count = 12) -> str:
        """A row per lane, for reading: parameters, results, and the reason where one failed."""
        return table(self, rows)

    @checked
    def save(self, path: str | Path) -> Path:
        """Write it to a file, `.nc` or `.mat`, as `gx.Result.save` does."""
        return save(self.to_xarray(), path)

    def to_xarray(self) -> xarray.Dataset:
        """The same as a plain `xarray.Dataset`."""
        return xarray.Dataset(self.variables).set_coords(list(self.coords)).assign_attrs(self.attrs)


def _nearest(values, x):
    """A value of the sweep that differs by rounding alone, else the one given."""
    if values.dtype.kind in "iuf" and isinstance(x, (int, float, np.number)):
        best = values[np.argmin(np.abs(values - x))]
        if abs(best - x) <= SAME * abs(x) or values.dtype.kind in "iu" and float(x).is_integer():
            return best.item() if abs(best - x) <= SAME * abs(x) else int(x)
    return x


def known(data: xarray.Dataset, function: Callable | None, points: Points | None) -> Sweep:
    """A dataset as a `Sweep` that knows its function."""
    found = Sweep(data.variables, attrs=data.attrs).set_coords(list(data.coords))
    for name, x in found.variables.items():
        if x.dtype == object:  # words that a file has held
            found[name] = x.dims, x.values.astype(str), x.attrs
    found._function, found._points = function, points
    return found
