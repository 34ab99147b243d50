"""Breathers continued from the anticontinuous limit, in which sites do not feel each other."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jax.flatten_util import ravel_pytree

from ..checks import positive, refuse
from ..flow import Flow
from ..solvers import KahanLi8
from ..tuning import one_thread
from ..types import Count, Scalar, Site
from .branch import Branch
from .breather import refuse_resonance, resonant_harmonic
from .confirm import LEFT_ON_BRANCH, newtons
from .families import confirmed_branch, half_steps
from .guesses import single_site
from .localised import FEWEST, localisation
from .problems import Family, Shooting
from .repeats import checked_lattice, largest

# steps along the branch, in the amplitude of the limit and in the whole way of the coupling: the first, and over it the
# longest and the least
ARCLENGTH = 0.1
LONGEST = 4.0
LEAST = 1e-4
# of its amplitude, to which a breather is known
TOLERANCE = 1e-10
# what continuation says before the reason of a veto
VETOED = "vetoed, "
# of the largest force in the limit, what other sites may move and feel: rounding
FELT = 1e-9


@one_thread
def anticontinuous(
    scene: Callable[[Any], Any],
    coupling: Scalar,
    omega: Scalar,
    sites: Site | Sequence[Site] | None = None,
    *,
    amplitudes: Sequence[Scalar] | None = None,
    field: str | None = None,
    arclength: Scalar = ARCLENGTH,
    points: Count = 100,
    steps: Count | None = None,
    solver: AbstractSolver | None = None,
    tolerance: Scalar = TOLERANCE,
    stability: bool = True,
) -> Branch:
    r"""Breathers of one frequency over the coupling, from the limit of none, in which each site moves by itself.

    At coupling zero the named sites oscillate at omega, each as its own nonlinear oscillator, and all others rest.
    Where no harmonic of omega is a frequency of small oscillations this orbit has one continuation (MacKay and Aubry),
    which is followed by pseudo-arclength through folds. The branch ends before a point at which a harmonic meets the
    band of the waves, or where the orbit is no more localised, and says so: none of its points is such an orbit.

    **Arguments:**

    - `scene(coupling)`: the `Lattice`, traced: `lambda c: gx.scenes.klein_gordon(21, c)`; conservative, its sites not
      coupled at 0. The same function again compiles nothing. Contacts couple too, of which the breathers fall off
      faster than exponentially: `lambda A: gx.scenes.cradle(9, stiffness=A, length=1.0)`.
    - `coupling`: where the branch ends, not zero; in the unit that the scene takes.
    - `omega` [rad/s]: above the frequency of small oscillations where the force on the sites hardens, below it where it
      softens.
    - `sites`: an index or several (on a grid a pair or several pairs), which oscillate in the limit; `None` is the
      middle. `amplitudes`: their signs +-1 (None: all in phase), a code of a multibreather; `field`: where a cell
      holds several. All sites but one make a dark breather.
    - `arclength`: first step along the branch, in which the way of the coupling counts 1, and so does a change of a
      displacement by the amplitude in the limit; `points`: the most breathers.
    - `steps`: time steps in a period, an even number; `None` doubles them until half as many confirm the largest
      breather to `tolerance`, relative to its amplitude, and its tangent map to 1e-8: many where contacts open.
      `solver`: a splitting method.
    - `stability`: also the multipliers.

    **Returns:** `Branch`, with the coupling as `p`; `branch.orbit(-1)` is the breather at the last one, which
    `gx.breathers.breather(scene(c), omega, guess=...)` refines, and with `energy=` takes to an energy. It has no
    derivative; that function's has.
    **Raises** ValueError for a coupling of zero, a frequency that no oscillation of the sites has or one of whose
    harmonics is a wave already in the limit, sites that are coupled there, and as `family`; RuntimeError where the
    first breather is not found. Typical: 11 to 41 sites, couplings up to a tenth of the stiffness of the sites.
    Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994); Marin, Aubry, Nonlinearity 9, 1501 (1996).

    **Example:**

    >>> scene = lambda coupling: gx.scenes.klein_gordon(5, coupling)
    >>> branch = gx.breathers.anticontinuous(scene, 0.02, 1.4, points=10, steps=64, stability=False)
    >>> branch.outcome
    'p reached 0.02.'
    >>> branch.u[-1].round(4).tolist()
    [0.0005, -0.0239, 1.1182, -0.0239, 0.0005]
    """
    omega = float(positive("omega", omega))
    end = float(coupling)
    if end == 0:
        refuse(
            "coupling",
            "a coupling to go to, not zero",
            repr(end),
            "At zero every site is by itself.",
        )
    period = 2 * np.pi / omega
    scene = _Traced(scene)
    lattices = [checked_lattice(scene(jnp.asarray(c))) for c in (0.0, end)]
    limit = _limit(lattices[0], omega, sites, amplitudes, field)
    length = float(largest(limit.u))
    count = max(half_steps(lattice, period, steps, limit) for lattice in lattices)
    half = Shooting.half(
        lattices[0], Flow(jnp.asarray(count, int), solver or KahanLi8()), length=length, omega=omega
    )
    left = newtons(tolerance, lattices[0].dtype, LEFT_ON_BRANCH)
    family = Family(half, scene, jnp.asarray(period), jnp.zeros(()), jnp.asarray(end), left)
    start = np.asarray(half.guess(limit))

    def follow(count):
        problem = family.with_steps(count)
        curve = problem.follow(
            start,
            0.0,
            until=(0.0, 1.0),
            arclength=arclength,
            longest_arclength=LONGEST * arclength,
            least_arclength=LEAST * arclength,
            points=points,
            veto=_veto(problem, omega, limit),
        )
        why = curve.outcome.partition(VETOED)[2]
        if why:
            curve = dataclasses.replace(curve, outcome=f"Ended: beyond its last point {why}")
        elif len(curve.p) > 1 and curve.p[-1] == 0:
            turned = f"turned back at the coupling {curve.p.max() * end:.6g}, a fold, to another breather without"
            curve = dataclasses.replace(curve, outcome=f"Ended: {turned}; none leads to {end:.6g}.")
        return problem, curve

    return confirmed_branch(follow, count, steps is None, tolerance, stability)


class _Traced(eqx.Module):
    """A scene that sees no number, so that one which refuses a coupling of zero is made too."""

    scene: Callable

    def __call__(self, coupling):
        return _scene(self.scene, coupling)


@eqx.filter_jit
def _scene(scene, coupling):
    return scene(coupling)


def _limit(lattice, omega, sites, amplitudes, field):
    """The state at rest of the limit, of a lattice whose sites do not feel each other."""
    refuse_resonance(lattice, omega, False, "")
    if sites is None:
        shape = lattice.sites
        shape = shape[field or lattice.fields[0]] if isinstance(shape, dict) else shape
        middle = tuple(n // 2 for n in shape)
        sites = middle[0] if len(middle) == 1 else [middle]
    state = single_site(lattice, omega, sites, amplitudes=amplitudes, field=field)
    u, force = (ravel_pytree(x)[0] for x in (state.u, lattice.force(jnp.zeros(()), *state)))
    named = 1 if np.ndim(sites) == 0 else len(sites)
    others = jnp.argsort(-jnp.abs(u))[named:]
    if any(float(largest(x[others])) > FELT * float(largest(x)) for x in (u, force)):
        refuse(
            "scene",
            "sites that do not feel each other at coupling 0",
            "others that are pushed",
            "A breather of a lattice without such a limit: gx.breathers.breather.",
        )
    return state


def _veto(problem, omega, limit):
    """Why a point of the branch is no breather: a harmonic among the waves, or an orbit that has spread."""
    first = localisation(problem.scene(jnp.zeros(()))[0], limit)
    # what fills the lattice may be a dark breather, whose first harmonic is a wave's
    kind, least = ("any", 2) if first.fills else ("bright", 1)

    def why(x, q, *before):
        lattice = problem.scene(jnp.asarray(q))[0]
        found = resonant_harmonic(lattice, omega, least)
        if found is not None:
            n, (low, high), _ = found
            return f"{n} omega = {n * omega:.6g} meets the waves of {low:.6g} ... {high:.6g}"
        spread = localisation(lattice, problem.shooting.state(jnp.asarray(x)))
        if spread.cells < FEWEST or spread.why_not(kind, first) is None:
            return None
        return f"it is not localised, {spread} (participation number; {first.participation:.3g} in the limit)"

    return why
