"""Waves as fixed points of "run for 1/c, then shift by one site", and their stability, by the code of orbits."""

from dataclasses import fields
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.linalg import schur, solve_discrete_lyapunov

from ..checks import one_of, refuse
from ..flow import Flow
from ..lattice import Lattice, State
from ..laws import Strained
from ..orbits import Orbit, Translation, orbit
from ..orbits.floquet import STABLE, UNDECIDED, Floquet, decide
from ..orbits.spectrum import known_spectrum
from ..profiles.medium import values
from ..results import hidden
from ..solvers import KahanLi8
from ..strains import Shift
from ..terms import Bond
from ..types import Count, Scalar, StateLike
from ..units import SCALED

# strain over the peak where a ring closes, by default; sites of the shortest and the longest
CLOSED, SHORTEST, LONGEST = 1e-10, 12, 200
# wave numbers at which the essential spectrum is looked at
WAVES = 256
# where far states are held: growth of the norm per contact without sound; steps at first and at most, to which the
# matrix is known
RATE, STEPS, MOST, KNOWN = 1.0, 64, 2048, 1e-7


def ring(wave: Any, sites: Count | None = None) -> tuple[Lattice, State]:
    """A ring in which a wave runs, and the wave in its middle, displacements about the mean strain.

    The wave shortens the ring by its compression, so that every bond has the mean strain s = compression/sites at rest
    and the law F(e + s) - F(s); displacements are periodic then, and a shift by one site is a symmetry. The ring's own
    wave differs by what the tail has left half-way round.

    **Arguments:** `sites`: `None` is as many as bring the strain half-way round to 1e-10 of the peak.
    **Raises** ValueError where more than 200 are needed (a wave little faster than sound), or fewer than 12 asked.
    """
    sites = _sites_of(wave) if sites is None else sites
    s, centre = wave.compression / sites, sites // 2
    # the mean of the strains themselves, which is that of the integral to what the tail leaves
    xi = np.arange(sites) - centre
    e = jnp.asarray(wave.strain(xi)) - s
    e = e - e.mean()
    u = jnp.concatenate([jnp.zeros(1), -jnp.cumsum(e)[:-1]])
    lattice = Lattice(
        wave.mass,
        Bond(Shift(1, "periodic"), Strained(wave.law, s)),
        sites=sites,
        units=wave.units or SCALED,
    )
    v = wave.velocity(xi)
    return lattice, State(u - u.mean(), v - v.mean())


def _sites_of(wave):
    peak = abs(float(wave.amplitude))
    strains = np.abs(np.asarray(wave.strain(np.arange(LONGEST // 2 + 1.0))))
    half = int(np.argmax(strains < CLOSED * peak)) if strains[-1] < CLOSED * peak else None
    if half is None:
        refuse(
            "sites",
            f"the number of a ring, where more than {LONGEST} are needed to hold all of the tail",
            "None",
            "Give one; the matrix has twice as many rows, and the ring's wave is another one.",
        )
    return max(SHORTEST, 2 * half)


def wave_orbit(lattice: Lattice, guess: StateLike, speed: Scalar, **keywords: Any) -> Orbit:
    r"""A wave of any ring as a fixed point: y(1/c) = S y(0), S the shift by one site, by Newton's method.

    The lattice may have whatever terms: further neighbours, on-site forces, user-defined terms. `orbit.floquet()`
    tells its stability.

    **Arguments:** `lattice`: a ring of equal cells. `guess`: a state near the wave, such as that of `ring(wave)`, or of
    a lattice that is near. `speed`: c, sites per time, below zero to the left. `keywords`: of `gx.orbits.orbit`.
    **Returns:** `Orbit`. **Raises** as `gx.orbits.orbit` does, and ValueError for a speed of zero.
    """
    return orbit(
        lattice, guess, 1 / abs(speed), symmetry=Translation(1 if speed > 0 else -1), **keywords
    )


class WaveStability(Floquet):
    """What `stability` returns: a `Floquet` that says on how many sites of which lattice it was found."""

    sites: int = hidden("The sites of the ring or the chain.", static=True, kw_only=True)
    bound: float = hidden(
        "The bound on all multipliers but two of a chain with held ends, 0 of a ring.", kw_only=True
    )
    ring: Floquet | None = hidden(
        "What was found on the ring, where held ends have decided.", default=None, kw_only=True
    )
    held: Floquet | None = hidden("What these have found.", default=None, kw_only=True)
    essential: np.ndarray = hidden(
        "Multipliers of small waves far from this one, on the infinite chain: the essential "
        "spectrum, in the norm in which it was found.",
        kw_only=True,
    )

    @property
    def point(self) -> np.ndarray:
        """The multipliers beyond the essential spectrum by more than their errors: they are the wave's own.

        Those of a ring that held ends do not find are small waves that run round it.
        """
        own = self.held or self
        beyond = np.abs(own.multipliers) > np.abs(own.essential).max() + own.error
        return own.multipliers[beyond]

    @property
    def outcome(self) -> str:
        """Where it was found, and what led to the verdict."""
        if self.bound:
            place = f"On a chain of {self.sites} sites with held ends:"
            if self.bound >= 1:
                return f"{place} {super().outcome}"
            return (
                f"{place} every perturbation that does not change the place or the speed falls behind "
                f"the wave, since all other multipliers are below {self.bound:.4g} in modulus. "
                "2 multipliers at +1 are those of symmetry."
            )
        place = f"On a ring of {self.sites} sites:"
        if self.ring is None:
            return f"{place} {super().outcome}"
        grow = "Small waves that run round the ring and meet the wave again make some grow."
        fewer = len(self.unstable) < len(self.ring.unstable)
        return f"{place} {self.ring.outcome} {f'{grow} ' if fewer else ''}{self.held.outcome}"


def stability(
    wave: Any, sites: Count | None = None, ends: str | None = None, **keywords: Any
) -> WaveStability:
    r"""Multipliers of a wave over the time in which it runs one site: of S^-1 D y(1/c), with errors and a verdict.

    `ends="ring"`: the wave is set on a `ring`, refined there by Newton's method and judged as any orbit is, with Krein
    signatures and four multipliers at +1 (phase and energy, displacement and momentum); the continuous spectrum is a
    set of points on or near the unit circle. Small waves run round the ring and meet the wave again, which makes some
    of them grow, by less the longer the ring is. So where a multiplier lies outside the circle, held ends decide; what
    is the ring's own is then part of the `error`. `ends="held"`: a chain whose far states are held: at every shift a
    bead at rest comes in ahead and one is left behind. Two multipliers are at +1 (place and speed), those of what the
    wave leaves behind lie within the circle, in a norm that grows ahead of the wave (Pego and Weinstein), and there is
    no signature. Where nothing carries sound, perturbations behind the wave stay or drift on, and come again on a ring.

    Where dE/dc passes zero along a family one pair leaves +1 (Friesecke and Pego, Nonlinearity 17, 207 (2004);
    Cuevas-Maraver and others, Phys. Rev. E 96, 032214 (2017)).

    **Arguments:** `sites`: of the ring or the chain, `None` by the tail. `ends`: `None` is "ring" where there is sound,
    "held" elsewhere. `keywords`: of `gx.floquet.floquet` on a ring.
    **Returns:** `WaveStability`, whose outcome names the ring or the chain; `essential` is the essential spectrum of
    the infinite chain, `point` what lies beyond it. **Raises** as `ring` and `wave_orbit` do.

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Hertz(), speed=1.0)
    >>> gx.travelling.stability(wave).verdict
    'stable'
    """
    ends = ("ring" if np.isfinite(float(wave.decay)) else "held") if ends is None else ends
    if one_of("ends", ends, ("ring", "held")) == "ring":
        lattice, state = ring(wave, sites)
        found = wave_orbit(lattice, state, float(wave.speed)).floquet(**keywords)
        return _judged(found, wave, lattice.shape[0])
    if keywords:
        refuse(
            "keywords",
            "none where the far states are held",
            ", ".join(keywords),
            'They belong to ends="ring".',
        )
    return _held(wave, _sites_of(wave) if sites is None else sites)


def _judged(found, wave, sites):
    """What was found on a ring, judged by held ends where the ring itself may be why a multiplier leaves the circle."""
    told = {field.name: getattr(found, field.name) for field in fields(found)}
    told |= {"sites": sites, "bound": 0.0, "essential": _essential(wave, 0.0)}
    if found.verdict == STABLE:
        return WaveStability(**told)
    held, rho = _held(wave, sites), found.multipliers
    # those of the wave, with their inverses; what else is off the circle is the ring's own
    growing = held.multipliers[held.unstable]
    waves = np.abs(rho[:, None] - np.concatenate([growing, 1 / growing])).argmin(0)
    own = np.setdiff1d(np.arange(len(rho)) if held.verdict != UNDECIDED else [], waves).astype(int)
    error = found.error.copy()
    error[own] = np.maximum(error[own], np.abs(np.abs(rho[own]) - 1))
    told |= {"error": error, "verdict": held.verdict, "ring": found, "held": held}
    return WaveStability(**told)


def _held(wave, sites):
    lattice = Lattice(
        wave.mass, Bond(Shift(1, "free"), wave.law), sites=sites, units=wave.units or SCALED
    )
    state, period, forward = wave.state(sites), 1 / abs(float(wave.speed)), float(wave.speed) > 0
    decay = float(wave.decay)
    rate = decay / 2 if np.isfinite(decay) else RATE
    weights = np.exp(rate * (np.arange(sites) - (sites - 2) / 2) * (1 if forward else -1))
    weights = np.concatenate([weights, weights * period / (2 * np.pi)])
    back = np.kron(np.eye(2), np.eye(sites, k=1 if forward else -1))

    def monodromy(steps):
        factor = Flow(np.int64(steps), KahanLi8()).derivative(state, 0.0, period, lattice)[1]
        return (back @ np.asarray(factor)) * weights[:, None] / weights

    steps, coarse, fine = STEPS, monodromy(STEPS // 2), monodromy(STEPS)
    while np.abs(fine - coarse).max() > KNOWN * np.abs(fine).max() and steps < MOST:
        steps, coarse, fine = 2 * steps, fine, monodromy(2 * steps)
    about = float(np.linalg.norm(fine - coarse)) + 1e-14 * float(np.linalg.norm(fine))
    multipliers, vectors, error = known_spectrum(fine, coarse, about, 0.0)
    radius = _radius(fine, about)
    pair = np.argsort(np.abs(multipliers - 1))[:2]
    inside = np.setdiff1d(np.arange(len(multipliers)), pair)
    verdict = decide(multipliers, error, 2, False)
    if radius < 1:
        error[inside] = np.minimum(error[inside], np.abs(multipliers[inside]) + radius)
        verdict = STABLE
    unsigned = np.full(len(multipliers), np.nan)
    return WaveStability(
        fine / weights[:, None] * weights,
        multipliers,
        vectors / weights[:, None],
        error,
        unsigned,
        np.nan,
        about,
        2,
        verdict,
        period,
        int(steps),
        None,
        state,
        sites=sites,
        bound=radius,
        essential=_essential(wave, rate),
        **lattice.origin,
    )


def _essential(wave, rate):
    """exp(i (k - omega(k)/c)) of both directions, at wave numbers k + i rate: of waves that fall as exp(-rate n)."""
    k = 2 * np.pi * np.arange(WAVES) / WAVES + 1j * rate
    stiffness = values(wave.law, np.zeros(1))[1][0]
    omega = 2 * np.sqrt(stiffness / float(wave.mass)) * np.sin(k / 2)
    turns = omega / abs(float(wave.speed))
    return np.exp(1j * (k - np.stack([turns, -turns])))


def _radius(matrix, about):
    """A bound on all multipliers but the two nearest +1, of every matrix as near to this one; infinite where not found.

    In the norm x* P x, with R* P R + r^2 = r^2 P, what R is on the rest shrinks by the factor r (1 - 1/|P|)^{1/2}.
    """
    rho = np.linalg.eigvals(matrix)
    apart = np.sort(np.abs(rho - 1))[1:3].mean()
    triangle, _, count = schur(matrix, output="complex", sort=lambda x: abs(x - 1) < apart)
    rest = triangle[count:, count:]
    r = (1 + np.abs(np.diag(rest)).max(initial=0)) / 2
    if count != 2 or not r < 1:
        return np.inf
    norm = solve_discrete_lyapunov(rest.conj().T / r, np.eye(len(rest)))
    low, high = np.linalg.eigvalsh(norm)[[0, -1]]
    # what the solution leaves of its equation is taken off
    shrinks = np.linalg.eigvalsh(norm - rest.conj().T @ norm @ rest / r**2)[0] / high
    if not (low > 0 and shrinks > 0):
        return np.inf
    # of the two subspaces the angle, as what couples them over what sets them apart
    tilt = 1 + np.linalg.norm(triangle[:count, count:]) / apart
    return float(r * np.sqrt(1 - shrinks) + np.sqrt(high / low) * tilt * about)
