"""Standing solitons of first-order lattices, from the anti-continuous limit (no coupling)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ..base.checks import one_of, parameter, per_lane, refuse, traced
from ..base.types import Count, Number, Numbers, Parameter, Scalar
from ..continuation.newton import Root, newton
from ..results import Result, array, hidden
from .equations import DNLS, Equation

# four times the first coupling, relative to the detuning of the sites
WEAK = 0.1
# the largest factor by which a step raises the coupling
LONGEST = 1.5
# the least cosine between neighbouring profiles
ALIKE = 0.97
# the most steps, failed ones included
TRIES = 200
# the most steps of Newton's method
MOST = 60
# a localised profile has less than this share of its largest amplitude at the ends
LOCALISED = 0.05
# the largest relative residual of a soliton that Newton's method found
SOLVED = 1e-6
# no site has a larger squared amplitude
BEYOND = 1e60
FOUND = "Found: it is localised and stands still."


class Soliton(Result):
    """A standing solution psi_n(t) = phi_n exp(-i omega t), from `gx.first_order.soliton`."""

    psi: Numbers = array("The real amplitudes phi.", axes="site")
    omega: Number = array("The frequency.", "rad/s")
    norm: Number = array("The norm.")
    energy: Number = array("The energy.")
    residual: Number = array(
        "max |dH/dpsi* - omega psi| over max |psi| times |omega|, or of DNLS max(|omega - e|, 4 |V|)."
    )
    error: Number = array("The length of the next Newton step over max |psi|.")
    tail: Number = array("|phi| at the sites farthest from the highest one, over the highest.")
    root: Root = hidden("How Newton's method ended.")
    share: Number = hidden("The share of the coupling that was reached.")

    @property
    def outcome(self) -> str:
        if traced((self.psi, self.tail)):
            return "Not known while traced."
        if not np.all(self.root.converged):
            return self.root.outcome
        if np.min(self.share) < 1:
            return (
                f"The soliton of uncoupled sites does not reach the coupling, but {np.min(self.share):.4g} "
                "of it: take another centre, or a profile as guess."
            )
        if not np.all(self.residual < SOLVED):
            return "Newton's method fell to zero: start from a larger profile."
        tail = np.max(self.tail)
        if tail > LOCALISED:
            return (
                f"Not localised: far away it is {tail:.2g} of its height; take a longer chain or "
                "another frequency."
            )
        return FOUND


def soliton(
    equation: Equation,
    omega: Scalar,
    *,
    guess: str | Parameter = "site",
    centre: Count | None = None,
    throw: bool | None = None,
) -> Soliton:
    """Find a localised standing solution phi_n exp(-i omega t) by Newton's method.

    It solves dH/dpsi*(phi) = omega phi.

    **Arguments:**

    - `equation`: `DNLS`, whose coupling is raised from zero, where sites are independent; or any
      other, such as `DpS`, with a profile as `guess`.
    - `omega`: [rad/s], outside the band: below it if the sites focus (in-phase), above it if they
      defocus (staggered).
    - `guess`: `"site"`, one excited site at zero coupling; `"bond"`, two; or a real profile (N,).
    - `centre`: the site for these words, N // 2 by default.
    - `throw`: raise if it is not found, or is flat; `None` does.

    With a profile as `guess`, the numbers of the equation and omega may be traced, and it
    differentiates in both modes.
    **Returns:** `Soliton`; `evolve` of it with `equation` only turns its phase.
    **Raises** ValueError for lanes, or a frequency in the band or on the side where a single site
    has none; RuntimeError with the outcome. Source: MacKay, Aubry, Nonlinearity 7, 1623 (1994).

    **Example:**

    >>> found = gx.first_order.soliton(gx.first_order.DNLS(20), omega=-1.0)
    >>> round(float(found.psi[10]), 4), round(float(found.norm), 4)
    (1.4408, 3.1222)
    """
    omega = per_lane("omega", omega, ())
    if isinstance(guess, str):
        one_of("guess", guess, ("site", "bond"))
        if not isinstance(equation, DNLS):
            refuse(
                "guess",
                f"a profile (N,) for a {type(equation).__name__}",
                repr(guess),
                "Only DNLS has a limit of uncoupled sites. For DpS try 1, -2, 1 times an amplitude.",
            )
        root, share = _raised(
            equation, omega, guess, equation.sites // 2 if centre is None else centre
        )
    else:
        phi = parameter("guess", guess)
        if phi.shape != (equation.sites,):
            refuse("guess", f"a profile of shape ({equation.sites},)", f"shape {phi.shape}")
        share = jnp.ones_like(omega)
        root = _found(equation, omega, phi, share)
    made = _made(equation, omega, root, share)
    if (throw is None or throw) and not traced(made) and made.outcome != FOUND:
        raise RuntimeError(made.outcome)
    return made


def _residual(phi, args):
    equation, omega, share = args
    if isinstance(equation, DNLS):
        equation = eqx.tree_at(lambda e: e.coupling, equation, equation.coupling * share)
    return jnp.real(equation.rate(phi)) - omega * phi


def _found(equation, omega, phi, share):
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(phi)) * rate_scale(equation, omega))
    return newton(
        _residual,
        phi,
        (equation, omega, share),
        tolerance=max(1e-12, 4 * float(jnp.finfo(phi.dtype).eps)) * size,
        max_steps=MOST,
        throw=False,
    )


def rate_scale(equation: Equation, omega: Number) -> Number:
    """Return the rate that residuals are relative to, the same in all rotating frames of DNLS."""
    if not isinstance(equation, DNLS):
        return jnp.abs(omega)
    own = omega if equation.potential is None else omega - equation.potential
    return jnp.maximum(jnp.max(jnp.abs(own)), 4 * jnp.max(jnp.abs(equation.coupling)))


def _raised(equation, omega, guess, centre):
    known = float(omega)
    potential = np.zeros(1) if equation.potential is None else np.asarray(equation.potential)
    _refuse_band(equation, known, potential)
    N = equation.sites
    last = N - (guess == "bond" and equation.laplacian.diagonal is not None)
    if not -N <= centre < N or not centre % N < last:
        refuse("centre", f"one of the first {last} sites", f"{centre}")
    coupling = float(equation.coupling)
    places = np.arange(centre, centre + 1 + (guess == "bond")) % N
    own = np.broadcast_to(potential, N)[places]
    phi = np.zeros(N)
    phi[places] = [_alone(equation, known, float(x)) for x in own]
    # Below the band neighbours are in phase, above it they are not; for V < 0 it is the reverse.
    if coupling * (own[0] - known) < 0:
        phi[places[1:]] *= -1
    phi = jnp.asarray(phi)
    reached = 0.0
    root = _found(equation, omega, phi, jnp.asarray(reached))
    share = min(1.0, WEAK * np.abs(own - known).min() / (4 * abs(coupling) + 1e-300))
    factor = LONGEST
    for _ in range(TRIES):
        tried = _found(equation, omega, phi, jnp.asarray(share))
        follows = bool(tried.converged) and _alike(phi, tried.x)
        if follows:
            root = tried
            phi = root.x
            reached = share
        if reached == 1.0:
            break
        factor = min(LONGEST, factor**1.5) if follows else factor**0.5
        share = min(1.0, reached * factor) if reached else share / 2
    return root, jnp.asarray(reached)


def _alike(one, other):
    return np.vdot(one, other) > ALIKE * np.linalg.norm(one) * np.linalg.norm(other)


def _refuse_band(equation, omega, potential):
    values = np.asarray(equation.laplacian.values)
    if np.ndim(equation.coupling) or values.ndim != 1:
        refuse("equation", "one equation", "a batch of several", "Take one lane after the other.")
    if equation.laplacian.diagonal is not None:
        values = np.asarray(equation.laplacian.diagonal) * np.array([[0.0], [2.0]])
    values = np.asarray(equation.coupling) * values
    low = values.min() + potential.min()
    high = values.max() + potential.max()
    if low <= omega <= high:
        refuse(
            "omega",
            f"a frequency outside of the band [{low:.6g}, {high:.6g}]",
            f"{omega:.6g}",
            "Inside it a standing solution does not decay.",
        )


def _alone(equation, omega, potential):
    wanted = potential - omega

    def above(x):
        force = float(np.ravel(equation.nonlinearity.force(jnp.asarray(x)))[0])
        return np.sign(wanted) * (force - wanted)

    high = 1.0
    while above(high) < 0 and high < BEYOND:
        high *= 2
    if above(high) < 0:
        refuse(
            "omega",
            "a frequency that a single uncoupled site can have",
            f"{omega:.6g}",
            "Below the band the sites must focus (nonlinearity > 0), above it defocus.",
        )
    return np.sqrt(scipy.optimize.brentq(above, 0.0, high, xtol=1e-300, maxiter=2000))


def _made(equation, omega, root: Root, share):
    phi = root.x
    highest = jnp.max(jnp.abs(phi))
    size = jnp.where(highest > 0, highest, 1.0)
    args = equation, omega, jnp.ones_like(omega)
    left = _residual(phi, args)
    step = jnp.linalg.lstsq(root.jacobian, left)[0]
    psi = phi.astype(jnp.result_type(phi, jnp.complex64))
    return Soliton(
        phi,
        omega,
        equation.norm(psi),
        equation.energy(psi),
        jnp.where(
            highest > 0, jnp.max(jnp.abs(left)) / (size * rate_scale(equation, omega)), jnp.inf
        ),
        jnp.max(jnp.abs(step)) / size,
        _tail(equation, jnp.abs(phi) / size),
        root,
        share,
        _space=(1, 0),
    )


def _tail(equation, shape):
    apart = jnp.abs(jnp.arange(len(shape)) - jnp.argmax(shape))
    ring = getattr(equation, "boundary", None) == "periodic" or (
        isinstance(equation, DNLS) and equation.laplacian.diagonal is None
    )
    apart = jnp.minimum(apart, len(shape) - apart) if ring else apart
    return jnp.max(jnp.where(apart == apart.max(), shape, 0.0))
