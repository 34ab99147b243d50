"""Heat baths: splitting steps with the exact flow of the `Langevin` terms."""

from functools import partial
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..base.checks import refuse
from ..base.types import Displacements, Number
from ..lattice import Lattice, split_system
from ..solvers import AbstractSplitting, VelocityVerlet
from ..solvers.interpolation import QuinticHermite
from ..solvers.wrapped import Wrapped
from ..terms import Langevin
from ..terms.base import get, replaced, within

# A time this near the end of a step, in steps, is that end: sums of steps have rounding errors. In
# float32 they are larger from about 1000 steps on.
NEARLY = 1e-2


def baths(lattice: Lattice) -> tuple[Langevin, ...]:
    """Return the heat baths. **Raises** ValueError for one within another term."""
    for i, term in enumerate(lattice.terms):
        if isinstance(within(term), Langevin) and not isinstance(term, Langevin):
            refuse(
                f"terms[{i}] ({type(term).__name__})",
                "a heat bath that is a term itself",
                "one within another term, where it has no noise",
                "A subclass in other units needs dimensions = gx.Langevin.dimensions.",
            )
    return tuple(term for term in lattice.terms if isinstance(term, Langevin))


def isolated(lattice: Lattice) -> Lattice:
    """Return the lattice without its heat baths."""
    if not baths(lattice):
        return lattice
    rest = tuple(term for term in lattice.terms if not isinstance(term, Langevin))
    return eqx.tree_at(lambda x: x.terms, lattice, rest)


def refuse_unfit(
    solver: Any, tolerance: Any, confirm: bool, backwards: bool, even: bool, sampled: bool
) -> None:
    """Refuse arguments that a run with heat baths does not support."""
    if tolerance is not None or not isinstance(solver, AbstractSplitting):
        got = f"{type(solver).__name__}, tolerance={tolerance}"
        refuse("solver", "a splitting solver and step= with heat baths", got, "Try gx.SRKN11b().")
    if confirm or backwards:
        got = "confirm=True" if confirm else "Reversible()"
        remedy = "Steps of another length have other noise: compare averages of runs."
        refuse("confirm, adjoint", "False and no Reversible() with heat baths", got, remedy)
    if not even:
        wanted = "times at an even spacing from t0 to t1, or 'steps', with heat baths"
        refuse("save_at", wanted, "other times", "Between steps there is no path to read.")
    if sampled and isinstance(solver, VelocityVerlet):
        wanted = "none that looks between steps, with VelocityVerlet and heat baths"
        remedy = "The baths act in the middle of its steps. Try gx.SRKN11b()."
        refuse("record", wanted, "one that does", remedy)


class _Ended(QuinticHermite):
    # Within a step the path between its baths; at its ends the states before and after both.

    before: Any = None
    after: Any = None

    def at(self, t):
        near = NEARLY * (self.t1 - self.t0)

        def chosen(before, between, after):
            late = jnp.where(t > self.t1 - near, after, between)
            return jnp.where(t < self.t0 + near, before, late)

        return jax.tree.map(chosen, self.before, super().at(t), self.after)


class Bathed(Wrapped):
    """A splitting solver of the isolated lattice, with half a step of the baths on either side.

    The baths keep the canonical distribution exactly, the solver to its order. Between baths of
    unequal temperatures a whole step of them before the solver's would leave the bathed sites with
    an error of first order in h; halves on either side leave h^2. With `VelocityVerlet` the baths
    act in the middle of its drift instead.
    """

    interpolation_cls: ClassVar = _Ended

    def init(self, terms, t0, t1, y0, args):
        # The time enters the key, so that a run that continues another one does not repeat its
        # noise.
        time = jnp.atleast_1d(jax.lax.bitcast_convert_type(t0, jnp.uint32))
        keys = [_keys(bath.seed, args.lanes, time) for bath in baths(args)]
        return self.solver.init(terms, t0, t1, y0, isolated(args)), keys

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, keys = solver_state
        parts = [_each(lambda key: jax.random.split(key, 3), key) for key in keys]
        keys, first, second = ([part[..., i] for part in parts] for i in range(3))
        h = t1 - t0
        alone = isolated(args)
        if isinstance(self.solver, VelocityVerlet):
            bathed = partial(_bathed, args, h=h, keys=first)
            y1, dense, own = _baoab(alone, y0, t0, t1, own, bathed)
            ends = dict(before=y0, after=y1)
            return y1, None, dense | ends, (own, keys), diffrax.RESULTS.successful
        start = y0._replace(v=_bathed(args, y0.v, h / 2, first))
        step = self.solver.step(terms, t0, t1, start, alone, own, made_jump)
        end, error, dense, own, result = step
        y1 = end._replace(v=_bathed(args, end.v, h / 2, second))
        return y1, error, dense | dict(before=y0, after=y1), (own, keys), result


def _baoab(lattice, y0, t0, t1, kept, bathed):
    # Half a kick, half a drift, the baths, half a drift, half a kick.
    system = split_system(lattice)
    half = (t1 - t0) / 2
    w = system.drift(system.kick(system.enter(y0, kept), half), half)
    middle, cache = system.leave(w, y0)
    middle = middle._replace(v=bathed(middle.v))
    w = system.refresh(system.drift(system.enter(middle, cache), half), t1)
    y1, new = system.leave(system.kick(w, half), y0)
    a0 = system.acceleration(y0, kept)
    a1 = system.acceleration(y1, new)
    return y1, dict(y0=y0, y1=y1, a0=a0, a1=a1, direction=jnp.ones_like(half)), new


def _bathed(lattice, v: Displacements, h: Number, keys: list) -> Displacements:
    for bath, key in zip(baths(lattice), keys):
        names = tuple(v) if isinstance(v, dict) else (None,)
        for i, name in enumerate(names):
            if bath.field in (None, name):
                own = _each(lambda k, i=i: jax.random.fold_in(k, i), key)
                new = _cooled(bath, get(v, name), get(lattice.mass, name), h, own)
                v = replaced(v, name, new)
    return v


def _cooled(bath, v, m, h, key):
    x = -bath.rate * h.astype(v.dtype)
    width = jnp.sqrt(-jnp.expm1(2 * x) * bath.temperature / m)
    sites = v.shape[: v.ndim - key.ndim]
    noise = _each(lambda k: jax.random.normal(k, sites, v.dtype), key)
    # Lanes are the first axes of the draws, and are moved last.
    noise = jnp.moveaxis(noise, range(key.ndim), range(v.ndim - key.ndim, v.ndim))
    return jnp.exp(x) * v + width * noise


def _keys(seed, lanes, time):
    # One key for each lane, from its seed, the number of lanes before it with the same seed, and
    # the time.
    seeds = jnp.broadcast_to(seed, lanes).ravel()
    order = jnp.argsort(seeds, stable=True)
    place = jnp.argsort(order)
    before = place - jnp.searchsorted(seeds[order], seeds)

    def one(seed, before):
        key = jax.random.key(seed)
        for part in (before, *time):
            key = jax.random.fold_in(key, part)
        return key

    return jax.vmap(one)(seeds, before).reshape(lanes)


def _each(function, keys):
    # Maps a function of one key over the keys of all lanes.
    for _ in range(keys.ndim):
        function = jax.vmap(function)
    return function(keys)
