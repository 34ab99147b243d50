"""A state of a trajectory that was saved."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import is_whole, refuse
from ..lattice import Lattice, State
from ..lattice.model import check_shape
from ..types import Count


def stored(lattice: Lattice, data: Any, frame: Count = -1) -> State:
    """The state of one frame of a run's dataset: where a run that was saved goes on.

    `gx.simulate(lattice, gx.states.stored(lattice, xarray.open_dataset("run.nc")), t1)` begins with the last.

    **Arguments:** `data`: an `xarray.Dataset` with `u` and `v` over `time` and the lattice's sites, as
    `run.to_xarray()` gives it, with fields, components and lanes.
    `frame`: which of its times, negative from the end.

    **Raises** ValueError for a dataset without them, a frame that is not there, sites or lanes that are not those of
    the lattice, and numbers in SI where those of the lattice are scaled, or the other way round.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=51)
    >>> state = gx.states.stored(chain, run.to_xarray(), frame=-1)
    >>> bool((state.u == run.us[-1]).all())
    True
    """
    variables = getattr(data, "data_vars", {})
    fields = [None] if lattice.fields is None else [*lattice.fields]
    both = [{field: _of(data, variables, name, field) for field in fields} for name in ("u", "v")]
    said = data.attrs.get("units")
    if lattice.units and said in ("SI", "scaled") and said != lattice.units:
        refuse(
            "data",
            f"numbers in {lattice.units}, as those of the lattice",
            f"numbers in {said}",
            "run.in_units(...) and gx.Units lead from one to the other.",
        )
    made = []
    for name, parts in zip(("u", "v"), both):
        count = next(iter(parts.values())).sizes["time"]
        if not is_whole(frame) or not -count <= frame < count:
            refuse("frame", f"one of {count} frames, {-count} ... {count - 1}", repr(frame))
        x = {field: _frame(part.isel(time=frame)) for field, part in parts.items()}
        x = x[None] if lattice.fields is None else x
        check_shape(lattice, f"data.{name}", x)
        made.append(jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), x, lattice.template()))
    return State(*made)


def _of(data, variables, name, field):
    """The displacements or velocities of a field, over time."""
    for key in (name, f"{name}_{field}"):
        if key in variables and "time" in variables[key].dims:
            found = variables[key]
            if field is None or key != name:
                return found
            if "field" in found.dims and field in data["field"].values:
                return found.sel(field=field)
    there = ", ".join(map(str, variables)) or type(data).__name__
    whose = f" of the lattice's field {field!r}" if field else ""
    refuse("data", f"a dataset with {name} over time{whose}", there[:200])


def _frame(x):
    """Sites first, then components, lanes last."""
    first = [axis for axis in x.dims if str(axis).partition("_")[0] == "site"]
    first += [axis for axis in x.dims if axis == "component"]
    return np.asarray(x.transpose(*first, *(axis for axis in x.dims if axis not in first)).values)
