"""Lyapunov exponents of a lattice, forced or free, by renormalised tangents."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from ..checks import refuse
from ..flow.stepping import columns, matrix
from ..lattice import Lattice, State
from ..results import Held, Result, array, hidden, part
from ..solvers import SRKN11b
from ..types import Count, Scalar, StateLike
from .attractors import slowly
from .repeats import asked
from .steps import COARSE


class Lyapunov(Result):
    """What `lyapunov` returns."""

    exponents: Float[np.ndarray, " exponent"] = array(
        "The exponents, from the largest down.", "1/s"
    )
    uncertainty: Float[np.ndarray, " exponent"] = array(
        "The standard error of the mean over the windows plus the difference between the "
        "first and the second half of the run.",
        "1/s",
    )
    rates: Float[np.ndarray, "run exponent"] = array("The growth rate over each interval.", "1/s")
    state: State = part("The state at the end.", "site")
    forced: bool = hidden("Whether the lattice depends on time.", static=True)
    near: str = hidden(
        "Which stable orbit is near a motion that seems quasi-periodic.", static=True
    )
    exported: ClassVar[dict[str, Held]] = {
        "verdict": Held(
            doc='"chaotic", "periodic", "quasi-periodic", "regular", "at rest", "not finite", or '
            '"undecided" (the exponent is zero within its uncertainty and a stable orbit is near).'
        )
    }

    @property
    def verdict(self) -> str:
        """What the largest exponent says of the motion, a word."""
        if not np.isfinite(self.exponents).all():
            return "not finite"
        if self.chaotic:
            return "chaotic"
        if self.exponents[0] < -self.uncertainty[0]:
            return "periodic" if self.forced else "at rest"
        if not self.forced:
            return "regular"
        return "undecided" if self.near else "quasi-periodic"

    @property
    def outcome(self) -> str:
        """What the largest exponent says of the motion, a sentence."""
        verdict = self.verdict
        word = verdict.capitalize()
        value = f"the largest exponent is {self.exponents[0]:.3g} +- {self.uncertainty[0]:.1g}"
        if verdict == "not finite":
            return "The state ceased to be finite: take more steps per period."
        if verdict == "quasi-periodic":
            word = "Quasi-periodic, or periodic at the edge of stability"
        zero = {"regular": "its uncertainty", "quasi-periodic": "that", "undecided": "that"}
        within = f", zero within {zero[verdict]}" if verdict in zero else ""
        return f"{word}: {value}{within}. {self.near}".strip()

    @property
    def chaotic(self) -> bool:
        """Whether the largest exponent exceeds its uncertainty."""
        return bool(self.exponents[0] > self.uncertainty[0])


def lyapunov(
    lattice: Lattice,
    state: StateLike,
    period: Scalar,
    *,
    periods: Count = 1000,
    transient: Count = 100,
    number: Count = 1,
    windows: Count = 10,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    seed: Count = 0,
) -> Lyapunov:
    r"""The k largest Lyapunov exponents: mean growth of tangents that are made orthonormal again every period.

    With Q_0 random and Phi_i the derivative of the flow over period i: Phi_i Q_i = Q_{i+1} R_i,
    lambda_j = (1/(P T)) sum_i ln (R_i)_jj. Displacements count times the mean frequency of a step, so that both halves
    of a tangent have one size; the exponents do not depend on it.

    Exact: damping gamma of all sites makes the exponents pair, lambda_j + lambda_{2N+1-j} = -gamma, and the whole
    spectrum sum to -gamma N. Autonomous lattices have one exponent zero along the orbit unless it is at rest.

    **Arguments:**

    - `lattice`, `state` at t = 0; forced or not. `period`: T of the forcing, or of a lattice that no time drives any
      time between two orthonormalisations, short against 1/lambda.
    - `periods`: P, that count; `transient`: that do not, while state and tangents turn to where they belong.
    - `number`: k, from 1 to twice the number of displacements. `windows`: for the uncertainty, at least 4.
    - `steps`, `solver`: as in `settle`. `seed`: of the first tangents.

    **Returns:** `Lyapunov`. **Raises** ValueError for numbers that do not fit, a period after which the forces do not
    repeat, or a batch of lattices.
    An exponent below ln(P)/(P T) is not told from zero: near-by orbits of an integrable lattice part linearly in time.
    Source: Benettin, Galgani, Giorgilli, Strelcyn, Meccanica 15, 9 (1980); pairing: Dressler, Phys. Rev. A 38, 2103
    (1988).

    **Example:**

    >>> chain = gx.driven.driven_chain(gx.scenes.monomer(3, precompression=1.0), 0.01, 0.5, damping=0.5)
    >>> rest = gx.states.rest(chain)
    >>> found = gx.driven.lyapunov(chain, rest, 4 * np.pi, periods=40, transient=10, number=6, steps=64)
    >>> found.verdict, round(float(found.exponents.sum()), 4)  # -3 gamma
    ('periodic', -1.5)
    """
    state, period, flow = asked(lattice, state, period, 0.0, steps, solver, SRKN11b(), COARSE)
    size = ravel_pytree(state)[0].size
    if number > size:
        refuse("number", f"at most {size}, twice the number of displacements", f"{number}")
    if periods < windows:
        refuse("periods and windows", "a period in each window", f"{periods} and {windows}")
    start = np.random.default_rng(seed).normal(size=(size, number))
    # arrays, whose values compile nothing anew
    start, T = (jnp.asarray(x, lattice.dtype) for x in (start, period))
    end, logs = _grow(flow, lattice, state, start, T, transient + periods)
    rates = np.asarray(logs)[transient:] / period
    order = np.argsort(-rates.mean(0), kind="stable")
    rates = rates[:, order]
    exponents, uncertainty = rates.mean(0), _uncertainty(rates, windows)
    found = Lyapunov(exponents, uncertainty, rates, end, lattice.reads_time, "", **lattice.origin)
    if found.verdict == "quasi-periodic":
        near = slowly(flow, lattice, end, period)
        found = dataclasses.replace(found, near=near)
    return found


@eqx.filter_jit
def _grow(flow, lattice, state, start, period, periods):
    weight = jnp.concatenate(
        [
            ravel_pytree(jax.tree.map(lambda x: jnp.full(x.shape, flow.steps / period), state.u))[
                0
            ],
            jnp.ones(ravel_pytree(state.v)[0].size),
        ]
    )[:, None]

    def one(carry, _):
        y, Q = carry
        y, tangents = flow.tangents(y, columns(y, Q / weight), 0.0, period, lattice)
        Q, R = jnp.linalg.qr(weight * matrix(tangents))
        return (y, Q), jnp.log(jnp.abs(jnp.diagonal(R)))

    (state, _), logs = jax.lax.scan(one, (state, jnp.linalg.qr(start)[0]), length=periods)
    return state, logs


def _uncertainty(rates, windows):
    means = np.stack([part.mean(0) for part in np.array_split(rates, windows)])
    half = len(rates) // 2
    return means.std(0, ddof=1) / np.sqrt(windows) + np.abs(
        rates[:half].mean(0) - rates[half:].mean(0)
    )
