"""Self-trapping: the nonlinearity above which a site keeps its excitation."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import positive, refuse, within
from ..base.checks import tolerance as checked_tolerance
from ..base.types import Count, Number, Numbers, Scalar
from ..results import Result, array
from .evolution import evolve

# nonlinearities in one batch
LANES = 9
# the most batches
ROUNDS = 20


class SelfTrapping(Result):
    """The threshold of self-trapping, from `gx.first_order.self_trapping`."""

    nonlinearity: Number = array("The threshold.")
    error: Number = array("Half of the last bracket.")
    tried: Numbers = array("All nonlinearities that were tried, in order.", axes="tried")
    kept: Numbers = array("The least share of the norm on the site, at each one.", axes="tried")
    share: Number = array("The share that counts as trapped.")
    t1: Number = array("The time until which the motion was followed.", "s")

    @property
    def outcome(self) -> str:
        said = f"Trapped from {self.nonlinearity:.8g} +- {self.error:.1g} on, over a time of"
        said += f" {self.t1:g}."
        first = np.min(self.tried[self.kept > self.share])
        if first < self.nonlinearity:
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
    the threshold. `frames`: how many times are checked.
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
    tried = {}
    for _ in range(ROUNDS):
        values = np.linspace(low, high, LANES)
        batch = jax.vmap(scene, out_axes=-1)(jnp.asarray(values))
        run = evolve(batch, psi, t1, save_at=frames, tolerance=1e-6)
        kept = np.asarray(jnp.min(run.densities[:, site], axis=0))
        tried |= dict(zip(values.tolist(), kept.tolist()))
        stays = kept > share
        if stays[0] or not stays[-1]:
            name, word = ("low", "does not trap") if stays[0] else ("high", "traps")
            refuse(
                name,
                f"a nonlinearity that {word}",
                f"{values[0 if stays[0] else -1]:g}",
                "Move the bracket, or wait longer.",
            )
        # where the motion is chaotic, values that trap lie among those that do not
        last = np.flatnonzero(~stays)[-1]
        low = values[last]
        high = values[last + 1]
        if high - low <= 2 * float(tolerance) * high:
            break
    tried = dict(sorted(tried.items()))
    return SelfTrapping(
        (low + high) / 2,
        (high - low) / 2,
        np.array(list(tried)),
        np.array(list(tried.values())),
        share,
        t1,
    )
