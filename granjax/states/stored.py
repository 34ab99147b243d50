"""A state of a saved trajectory."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import concrete, refuse, show
from ..base.types import Count
from ..base.units import SI
from ..base.units.names import known_unit
from ..flow.memory import memory_at, named
from ..lattice import Lattice, State
from ..lattice.model import check_shape

# What `u` and `v` are in, where they name no other unit.
UNITS = {"u": "m", "v": "m/s"}


def stored(lattice: Lattice, data: Any, frame: Count = -1) -> State:
    """Return the state of one frame of a saved run, to continue it.

    `gx.simulate(lattice, gx.states.stored(lattice, xarray.open_dataset("run.nc")), t1)` begins with
    the last frame.

    **Arguments:** `data`: an `xarray.Dataset` with `u`, `v` over sites, and optionally `time`, as
    from `run.to_xarray()` or `run.in_units("mm")`, with fields, components, and lanes in the
    lattice's order. `frame`: index of the time, negative from the end.

    **Raises** ValueError for sites, lanes, units or memory that do not fit the lattice; KeyError
    and IndexError for missing variables or frames.

    **Example:**

    >>> chain = gx.scenes.monomer(20)
    >>> run = gx.simulate(chain, gx.states.impact(chain), 5.0, step=0.05, save_at=51)
    >>> state = gx.states.stored(chain, run.to_xarray(), frame=-1)
    >>> bool((state.u == run.us[-1]).all())
    True
    """
    if not hasattr(data, "attrs"):
        refuse("data", "a dataset, such as run.to_xarray()", type(data).__name__)
    said = data.attrs.get("units")
    if lattice.units and said in ("SI", "scaled") and said != lattice.units:
        refuse(
            "data",
            f"numbers in {lattice.units}, as those of the lattice",
            f"numbers in {said}",
            "run.in_units(...) and gx.Units convert one into the other.",
        )
    made = []
    for name in ("u", "v"):
        if lattice.fields is None:
            x = _frame(data[name], frame)
        elif name in data and "field" in data[name].dims:
            x = {field: _frame(data[name].sel(field=field), frame) for field in lattice.fields}
        else:
            x = {field: _frame(data[f"{name}_{field}"], frame) for field in lattice.fields}
        like = lattice.template()
        values = jax.tree.map(lambda x: x.values, x)
        if lattice.units == SI:
            values = jax.tree.map(lambda x: _in_si(name, x, UNITS[name]), x)
        check_shape(lattice, f"data.{name}", values)
        for own, one in zip(jax.tree.leaves(x), jax.tree.leaves(like)):
            if own.ndim > one.ndim:
                remedy = f"Choose one lane: data.isel({own.dims[-1]}=0)."
                wanted = f"shape {one.shape}, that of the lattice"
                refuse(f"data.{name}", wanted, f"shape {own.shape}", remedy)
        made.append(jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), values, like))
    state = State(*made)
    _check_memory(lattice, state, data, frame)
    return state


def _check_memory(lattice, state, data, frame):
    # A run would begin with the memory of the lattice, not with that of the file.
    memory = memory_at(lattice, state)
    for i, own, name in named(lattice):
        term = lattice.terms[i]
        if memory[i] is None:
            refuse(
                "lattice",
                "forces whose memory a run returns",
                type(term).__name__,
                "Simulate the whole time at once; gx.State(u, v) begins with no history.",
            )
        mine = concrete(memory[i][own])
        if name not in data or mine is None:
            continue
        x = _frame(data[name], frame)
        x = _in_si(name, x, term.memory[own]) if lattice.units == SI else x.values
        # A file of single precision is as good as its numbers.
        eps = max(np.finfo(kind).eps for kind in (x.dtype, mine.dtype))
        if x.shape != mine.shape or np.abs(x - mine).max() > np.sqrt(eps) * np.abs(x).max():
            refuse(
                f"data.{name}",
                f"what the lattice remembers at this state, {show(mine)}",
                show(x),
                "run.lattice remembers the last frame; for another give its numbers to the terms, "
                "such as PlasticContact(..., largest=...), in the unit of the lattice.",
            )


def _in_si(name, x, own):
    # Return numbers that may say another unit than their own.
    word = x.attrs.get("units", own)
    unit = known_unit(word)
    if unit is None or unit.dimension != known_unit(own).dimension:
        refuse(f"data.{name}", f"numbers in {own}, or a unit like it", f"numbers in {word!r}")
    return unit.size * x.values


def _frame(x, frame):
    # Return one frame, with the axes site or bond, component, lanes.
    x = x.isel(time=frame) if "time" in x.dims else x
    first = [axis for axis in x.dims if str(axis).partition("_")[0] in ("site", "bond")]
    # A grid's axes are site, site_1, ..., or site_bead, site_bead_1, ...; other names stay in order.
    first.sort(key=lambda axis: [int(k) for k in str(axis).split("_") if k.isdecimal()])
    first += [axis for axis in x.dims if axis == "component"]
    return x.transpose(*first, ...)
