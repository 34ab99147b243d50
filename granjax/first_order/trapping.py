"""Self-trapping: the nonlinearity above which a site keeps its excitation."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import cubic_top
from ..base.checks import positive, refuse, within
from ..base.checks import tolerance as checked_tolerance
from ..base.programs import compiled
from ..base.types import Count, Number, Numbers, Scalar
from ..results import Result, array
from .equations import field
from .evolution import evolve, fastest_rate

# nonlinearities in one batch
LANES = 9
# the most batches
ROUNDS = 20
# the most times that the number of frames is doubled
FINER = 5


class SelfTrapping(Result):
    """The threshold of self-trapping, from `gx.first_order.self_trapping`."""

    nonlinearity: Number = array("The threshold.")
    error: Number = array("Half of the last bracket, outside of which `kept` decides.")
    tried: Numbers = array("All nonlinearities that were tried, in order.", axes="tried")
    kept: Numbers = array("The least share of the norm on the site, at each one.", axes="tried")
    kept_error: Numbers = array("The error of `kept`.", axes="tried")
    share: Number = array("The share that counts as trapped.")
    t1: Number = array("The time until which the motion was followed.", "s")

    @property
    def outcome(self) -> str:
        said = f"Trapped from {self.nonlinearity:.8g} +- {self.error:.1g} on, over a time of"
        said += f" {self.t1:g}."
        first = np.min(self.tried[self.kept - self.kept_error > self.share])
        if first < self.nonlinearity - self.error:
            said += (
                f" From {first:.6g} on, values that trap lie among values that do not: the"
                " threshold is not sharp, and may lie beyond the error given."
            )
        return said


def self_trapping(
    scene: Callable[[Any], Any],
    low: Scalar,
    high: Scalar,
    t1: Scalar,
    *,
    site: Count = 0,
    share: Scalar = 0.5,
    tolerance: Scalar = 1e-6,
    frames: Count = 200,
) -> SelfTrapping:
    """Find the nonlinearity above which an excited site always keeps more than a share of the norm.

    The start is psi = 1 on one site; batches of runs bracket the threshold. For the dimer it is
    chi = 4 V, where the period is infinite: an error e of the threshold takes a time of order
    log(1/e)/V. On a chain of order s < 1 it is lower than with next neighbours.

    **Arguments:** `scene`: nonlinearity -> `Equation`, such as
    `lambda chi: gx.first_order.DNLS(64, 1.0, chi)`; JAX traces it. `low`, `high`: nonlinearities
    that do not trap and that trap. `t1`: how long to follow the motion [s]. `site`, `share`: the
    site, and the share of the norm, in (0, 1). `tolerance`: half of the last bracket, relative to
    the threshold. `frames`: the fewest times that are checked; cubics join them.
    **Returns:** `SelfTrapping`. **Raises** ValueError if `low` traps or `high` does not.
    Sources: Kenkre, Campbell, PRB 34, 4959 (1986); Molina, Phys. Lett. A 384, 126180 (2020).
    """
    low = float(positive("low", low))
    high = float(positive("high", high))
    if not low < high:
        refuse("high", f"a nonlinearity above low = {low:g}", f"{high:g}")
    share = float(within("share", share, 0, 1, open_low=True, open_high=True))
    checked_tolerance("tolerance", tolerance)
    t1 = float(t1)
    sites = scene(low).sites
    if not -sites <= site < sites:  # JAX clips indices silently
        refuse("site", f"a site of {sites}", f"{site}")
    psi = jnp.zeros((sites, LANES)).at[site].set(1.0)
    # The fastest motion is resolved.
    fastest = float(fastest_rate(scene(high), psi[:, 0].astype(complex)))
    frames = 2 * math.ceil(max(int(frames), t1 * fastest, 2) / 2)
    most = 2**FINER * frames
    tried = {}
    known = False
    for _ in range(ROUNDS):
        values = np.linspace(low, high, LANES)
        batch = jax.vmap(scene, out_axes=-1)(jnp.asarray(values))
        run = evolve(batch, psi, t1, save_at=frames + 1, tolerance=0.1 * tolerance)
        kept, missed, error = (np.asarray(x) for x in _least(batch, run, site))
        # Finer frames help where they miss more than the run's own error.
        finer = frames < most and (missed > error)[np.abs(kept - share) <= missed + error].any()
        error = np.minimum(missed + error, 1.0)
        tried |= zip(values.tolist(), zip(kept.tolist(), error.tolist()))
        if not known:
            if kept[0] > share or not kept[-1] > share:
                if finer:
                    frames *= 2
                    continue
                name, word = ("low", "does not trap") if kept[0] > share else ("high", "traps")
                given = f"{low if name == 'low' else high:g}"
                remedy = "Move the bracket, or wait longer."
                refuse(name, f"a nonlinearity that {word}", given, remedy)
            known = True
        # Where the motion is chaotic, values that trap lie among those that do not. The ends of the
        # bracket are not decided by less than an error.
        first = np.flatnonzero(kept < share - error).max(initial=0)
        last = np.flatnonzero(kept <= share + error).max(initial=0)
        low = values[first]
        high = values[min(last + 1, LANES - 1)]
        if high - low <= 2 * float(tolerance) * high:
            break
        if high - low > (values[-1] - values[0]) / 2:
            if not finer:
                break
            frames *= 2
    tried = dict(sorted(tried.items()))
    return SelfTrapping(
        (low + high) / 2,
        (high - low) / 2,
        np.array(list(tried)),
        *np.array(list(tried.values())).T,
        share,
        t1,
    )


@compiled
def _least(equation, run, site):
    # The least density of a site, on cubics through the frames, the error of these, and the run's.
    # Cubics through every second frame miss sixteen times as much if frames are close: an eighth.
    rates = jax.lax.map(lambda psi: field(0.0, psi, equation)[site], run.psis)
    here = run.psis[:, site]
    x = run.densities[:, site]
    slope = 2 * jnp.real(here.conj() * rates) * run.ts[1]
    least = -cubic_top(-x[:-1], -x[1:], -slope[:-1], -slope[1:]).max(0)
    half = (x[:-2:2] + x[2::2]) / 2 + (slope[:-2:2] - slope[2::2]) / 4
    missed = jnp.abs(x[1::2] - half).max(0) / 8
    return least, missed, 2 * jnp.sqrt(x.max(0)) * run.error.max(0)
