"""Waves of chains with a cell of several sites: the chain in its own units, and the two ways to solve for a wave."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...checks import positive, refuse, show
from ...laws import Law
from ...profiles.fourier import (
    MOST,
    Box,
    Chain,
    Solved,
    faster,
    fourier,
    heaviness,
    newton,
    newton_with,
    response,
)
from ...profiles.start import ASTRAY, petviashvili
from .guess import from_struck, peak, pulse, struck
from .tail import Fit, Ripple, decay, drift_row, fit, margin, ripple_row, ripples

# columns of one program: a box, and the cells of a simulated chain
COLUMNS = (64, 4096, 8192)
POINTS = 5
# decays of the core after which the ripple is alone
DEEP = 29.0
# the same where there is none
DEEPER = 35.0
# the speed over the sound speed at which a wave of any cell is begun where it is lost at its own
SLOW = 1.06
# and beyond which one is not looked for
FASTEST = 8.0
# of the peak: the most that a wave without ripple leaves at the ends of a first box
FLAT = 0.05
# of the peak: what counts as no ripple
SILENT = 1e-11


@eqx.filter_jit
def _forces(law, e):
    def both(e):
        return jax.jvp(law.force, (e,), (jnp.ones_like(e),))

    return jax.vmap(both, in_axes=1, out_axes=1)(e)


def elementwise(law: Law, P: int, order: int, unit: float):
    """NumPy's force (order 0) or slope (1) of a law over a unit: (P, X) to (P, X)."""

    def of(e):
        width = next(
            (n for n in COLUMNS if n >= e.shape[1]), -(-e.shape[1] // COLUMNS[-1]) * COLUMNS[-1]
        )
        padded = np.zeros((P, width))
        padded[:, : e.shape[1]] = e
        return np.asarray(_forces(law, padded)[order])[:, : e.shape[1]] / unit

    return of


class Given(NamedTuple):
    """A chain in its own units, the mean mass, and the masses of its smallest cell."""

    chain: Chain
    mass: float
    masses: np.ndarray


def chain_of(law: Law, masses, speed: float, resonator=None) -> Given:
    """The chain of a law and the masses of a cell; its smallest period and its mirror are found here."""
    masses = np.atleast_1d(np.asarray(positive("masses", masses), float))
    if masses.ndim != 1:
        refuse(
            "masses",
            "one row of masses, those of a cell",
            f"shape {masses.shape}",
            "One wave at a time.",
        )
    P, mass = len(masses), masses.mean()
    wrong = [np.shape(x) for x in jax.tree.leaves(law) if np.shape(x) not in ((), (1,), (P,))]
    if wrong:
        refuse(
            "law",
            f"parameters that are numbers or one per bond of the cell, ({P},)",
            f"shape {wrong[0]}",
            "One wave at a time.",
        )
    unit = mass * speed**2
    force, slope = (elementwise(law, P, order, unit) for order in (0, 1))
    K2 = slope(np.zeros((P, 1)))[:, 0]
    attached = (
        None
        if resonator is None
        else (float(resonator.mass) / mass, float(resonator.stiffness) / unit)
    )
    chain = Chain(masses / mass, force, slope, K2, attached, None)
    if not (np.all(np.isfinite(K2) & (K2 >= 0)) and (np.all(K2 > 0) or not K2.any())):
        refuse(
            "law",
            "a stiffness at rest that is finite, above zero at all bonds or zero at all",
            show(K2 * unit),
        )
    period = next(d for d in range(1, P + 1) if P % d == 0 and _repeats(chain, d))
    own = np.arange(period)
    if period < P:

        def cut(f):
            return lambda e: f(np.tile(e, (P // period, 1)))[:period]

        chain = chain._replace(
            masses=chain.masses[own], force=cut(force), slope=cut(slope), K2=K2[own]
        )
    return Given(chain._replace(mirror=_mirror(chain)), mass, masses[own])


def _samples(chain):
    """Forces at compressions about the scale of a wave of speed 1, rows of bonds, for comparing laws."""
    with np.errstate(all="ignore"):
        return chain.force(np.tile(np.logspace(-30, 10, 401), (len(chain.masses), 1)))


def _same(one, other):
    return np.allclose(one, other, rtol=1e-12, atol=0, equal_nan=True)


def _repeats(chain, d):
    return _same(chain.masses, np.roll(chain.masses, d)) and _same(
        *(lambda f: (f, np.roll(f, d, 0)))(_samples(chain))
    )


def _mirror(chain):
    own, forces = np.arange(len(chain.masses)), _samples(chain)
    for s in own:
        if _same(chain.masses[(s - own) % len(own)], chain.masses) and _same(
            forces[(s - 1 - own) % len(own)], forces
        ):
            return int(s)
    return None


class Found(NamedTuple):
    """A wave in the chain's own units; `ripple` and `tail` are `None` where no linear wave keeps pace with it."""

    box: Box
    solved: Solved
    ripple: Ripple | None
    tail: Fit | None
    core: float
    waves: int


def on_a_box(chain: Chain) -> Found | str:
    """A wave of a chain with a stiffness at rest: the nanopteron whose ripple is the smallest; else why there is none.

    The box joins the wave's two tails. Over its length the ripple's amplitude a is 1/a^2 = A + B cos 2kL + C sin 2kL,
    the smallest a the half of what a wave without ripple before it would leave behind it.
    """
    waves = ripples(chain)
    core = min((DEEP if waves else DEEPER) / decay(chain), 220.0)
    half = core + 3 * 2 * np.pi / waves[0].wavenumber if waves else core
    if 2 * half * POINTS * len(chain.masses) > MOST:
        return f"it takes a box of {2 * half:.3g} sites, for its core or for its ripple, which is too long"
    if margin(chain) > FASTEST:
        return (
            f"at {margin(chain):.3g} times the speed of sound the chain is almost without a stiffness at rest, and "
            "the wave is beyond this method's reach; leave out the precompression"
        )
    started = _started(chain, half)
    if isinstance(started, str) and margin(chain) > 1.05 * SLOW:
        started = _iterated(chain, half) or _sped_up(chain, half) or started
    if isinstance(started, str):
        return started
    box, solved = started
    begun = _unresolved(solved.phi)
    for refined in range(4):
        worst = _unresolved(solved.phi)
        # a law that is not smooth is hardly resolved by more places
        slow = refined == 2 and worst > 1e-2 * begun
        if worst < 1e-12 or slow or 1.5 * box.points * len(chain.masses) > MOST:
            break
        before = np.abs(solved.phi).max()
        box, solved = _again(chain, box, solved.phi, box.half, 1.5 * _density(box))
        if not (solved.converged and 0.6 < np.abs(solved.phi).max() / before < 1.6):
            return "the wave was lost on a finer grid"
    if len(waves) != 1:
        return Found(box, solved, None, None, core, len(waves))
    return _smallest(chain, box, solved, waves[0], core)


def _rest(solved):
    """The strain at the ends of the box over the largest."""
    return np.abs(solved.phi[:, 0]).max() / np.abs(solved.phi).max()


def _density(box):
    return box.points / box.half / 2


def _box(chain, half, density):
    return Box(chain, half, 2 * int(np.ceil(half * density)))


def _again(chain, box, phi, half, density):
    """The wave on another box, from that on one."""
    other = _box(chain, half, density)
    guess = fourier(phi, box.half, np.clip(other.x, -box.half, box.half))
    return other, newton(other, guess)


def _unresolved(phi):
    """Largest of the highest tenth of a wave's Fourier coefficients, over its largest."""
    hat = np.abs(np.fft.rfft(phi, axis=1))
    return hat[:, int(0.9 * hat.shape[1]) :].max() / hat.max()


def _started(chain, half):
    """A wave on some box, from a pulse of the chain of equal masses, on which the cell's own are turned on."""
    top = peak(chain)
    if top is None:
        return "no strain at which the law is stiff enough for this speed, in compression or in tension"
    total = 1 + (chain.resonator[0] if chain.resonator else 0.0)

    def blended(part):
        masses = (1 - part) * total + part * chain.masses
        own = (
            None
            if chain.resonator is None or not part
            else (part * chain.resonator[0], part * chain.resonator[1])
        )
        return chain._replace(masses=masses, resonator=own)

    box = _box(blended(0.0), half, POINTS)
    solved = newton(box, pulse(blended(0.0), box, top))
    height = np.abs(solved.phi).max()
    # a chain that is compressed alike everywhere is a solution as well
    if not (
        solved.converged and 0.2 < height / np.abs(top.strain).max() < 5 and _rest(solved) < FLAT
    ):
        return f"Newton's method did not reach a wave of the chain of equal masses (residual {solved.residual:.1e})"
    step = 1.0 if np.ptp(chain.masses) < 0.5 and chain.resonator is None else 0.25
    found, part = _followed(blended, box, solved, 0.0, step, 0.05, (0.6, 1.6))
    return found or (
        f"the wave of equal masses was lost when {part:.0%} of what differs from them was turned on. The "
        "search failed, which does not say that there is none; the ripple may be as strong as the wave"
    )


def _followed(chain_at, box, solved, part, step, least, change):
    """The wave of chain_at(1) from that of another part, `None` where it is lost; and the part that was reached.

    `change`: what the peak may change by in a step, at least and at most.
    """
    half = box.half
    while part < 1:
        step = min(step, 1 - part)
        other, trial = _again(chain_at(part + step), box, solved.phi, half, POINTS)
        moved = np.abs(trial.phi).max() / np.abs(solved.phi).max()
        if trial.converged and change[0] < moved < change[1] and _rest(trial) < 1:
            part, box, solved, step = part + step, other, trial, 1.5 * step
        elif step > least:
            # a box that the ripple fits has no wave: another length does not fit it
            step, half = step / 2, half + 0.13
        else:
            return None, part
    return (box, solved), part


def _iterated(chain, half):
    """A wave on some box from Petviashvili's iteration for resonators that are left at rest; `None` where it is lost.

    Of one site with resonators, whose stiffness is brought to the nearest with which they are.
    """
    top = peak(chain)
    if chain.resonator is None or len(chain.masses) > 1 or top is None:
        return None
    nu, kappa = chain.resonator
    swings = max(np.round(np.sqrt(kappa * (1 + nu) / nu) / (2 * np.pi)), 1)
    quiet = chain._replace(resonator=(nu, (2 * np.pi * swings) ** 2 * nu / (1 + nu)))
    box, sign = _box(chain, half, POINTS), np.sign(top.strain[0])
    guess = sign * pulse(quiet, box, top)[0]

    def force(psi):
        e = sign * psi[None]
        return sign * chain.force(e)[0], chain.slope(e)[0]

    _, psi, change = petviashvili(
        force,
        float(chain.K2[0]),
        half,
        lambda x: guess,
        box.points,
        lambda k: heaviness(quiet, k)[0],
    )
    solved = newton(box, sign * psi[None])
    return (box, solved) if change < ASTRAY and solved.converged and _rest(solved) < 1 else None


def _sped_up(chain, half):
    """A wave on some box from one little faster than sound, whose ripple is small; `None` where it is lost."""
    least = SLOW / margin(chain)
    slow = faster(chain, least)
    started = _started(slow, half + DEEP / decay(slow) - DEEP / decay(chain))
    if isinstance(started, str):
        return None
    return _followed(lambda x: faster(chain, x), *started, least, 0.05, 0.01, (0.9, 2.5))[0]


def _smallest(chain, box, solved, ripple, core):
    k, density = ripple.wavenumber, _density(box)
    found = fit(box, solved.phi, ripple, core)
    top = np.abs(solved.phi).max()
    if np.abs(found.amplitude) < SILENT * top:
        return Found(box, solved, ripple, found, core, 1)
    best = box, solved, found
    for _ in range(3):
        # three lengths that spread over one period of the ripple about the best so far; near some there is no wave
        lengths, sizes = [best[0].half], [np.abs(best[2].amplitude)]
        for part in (1, -1, 0.5, -0.5):
            if len(lengths) == 3:
                break
            one, at = _again(
                chain, best[0], best[1].phi, best[0].half + part * np.pi / (3 * k), density
            )
            if at.converged:
                lengths, sizes = (
                    [*lengths, one.half],
                    [*sizes, np.abs(fit(one, at.phi, ripple, core).amplitude)],
                )
        if len(lengths) < 3:
            break
        phase = 2 * k * np.array(lengths)
        A, B, C = np.linalg.solve(
            np.stack([np.ones(3), np.cos(phase), np.sin(phase)], 1), 1 / np.array(sizes) ** 2
        )
        half = (
            best[0].half
            + (np.arctan2(C, B) / (2 * k) - best[0].half + np.pi / (2 * k)) % (np.pi / k)
            - np.pi / (2 * k)
        )
        one, at = _again(chain, best[0], best[1].phi, half, density)
        if not at.converged:
            break
        size = fit(one, at.phi, ripple, core)
        gain = np.abs(size.amplitude) / np.abs(best[2].amplitude)
        if gain < 1:
            best = one, at, size
        if gain > 0.97:
            break
    return Found(*best[:2], ripple, best[2], core, 1)


def without_tail(chain_at, low: float, high: float, parts=(0.5, 0.2, 0.8)) -> Found | str:
    """A wave without ripple, and the parameter in [low, high] where it is; else why none was found.

    `chain_at`: parameter to `Chain`. With a stiffness at rest the ripple's amplitude is to vanish, without one the
    drift (or gap) that the pulse leaves between neighbours. `parts`: of the interval, where it is begun.
    """
    why = ""
    for part in parts:
        p = low + part * (high - low)
        chain = chain_at(p)
        begun = _with_ripple(chain) if chain.K2.any() else _simulated(chain)
        if isinstance(begun, str):
            why = begun
            continue
        box, phi, speed, row, core = begun
        for goal in np.unique([speed, 1.0])[:: 1 if speed < 1 else -1]:

            def box_of(p, goal=goal):
                return Box(faster(chain_at(p), goal), box.half, box.points)

            solved = newton_with(box_of, row, phi, p, 0.2 * (high - low))
            if not solved.converged:
                break
            p, phi = solved.parameter, solved.phi
        if solved.converged and low <= p <= high and np.abs(phi).max() > 0:
            return Found(box_of(p), solved, None, None, core, 0)
        why = (
            f"Newton's method went to {p:.6g}, outside of the interval"
            if solved.converged
            else f"Newton's method stopped at a residual of {solved.residual:.1e}"
        )
    return why


def _with_ripple(chain):
    begun = on_a_box(chain)
    if isinstance(begun, str):
        return begun
    if begun.ripple is None:
        return f"{begun.waves} linear waves keep pace with it, and one parameter can silence one"
    row = lambda box: ripple_row(ripples(box.chain)[0], begun.core)(box)
    return begun.box, begun.solved.phi, 1.0, row, begun.core


def _simulated(chain):
    top = peak(chain)
    if top is None:
        return "no strain at which the law is stiff enough for this speed"
    found = struck(chain, top)
    if found is None:
        return "a blow made no pulse that could be followed"
    box = Box(chain, found.width + 7.0, 2 * int(8 * (found.width + 7.0)))
    row = value_row if (chain.mirror - 1) % len(chain.masses) == 0 else drift_row
    return box, from_struck(found, box), found.speed, row, found.width + 5.0


def value_row(box):
    """The row that takes strains to the first bond's at the box's end: a gap that the pulse leaves."""
    out = np.zeros(box.shape[0] * box.points)
    out[0] = 1.0
    return out


def of_one_site(chain: Chain) -> Found | str:
    """The wave of equal beads without a stiffness at rest; with resonators the one of the smallest ripple."""
    total = heaviness(chain, np.zeros(1)).mean()
    begun = _simulated(chain._replace(masses=np.full(1, total), resonator=None))
    if isinstance(begun, str):
        return begun
    first, phi, _, _, core = begun
    if chain.resonator is None:
        solved = newton(first, phi)
        return (
            Found(first, solved, None, None, core, 0)
            if solved.converged
            else "Newton's method did not converge"
        )
    nu, kappa = chain.resonator
    ripple = Ripple(float(np.sqrt(kappa * (1 + nu) / nu)), np.ones(1, complex))
    # as far from the lengths that the ripple fits as can be, four wavelengths beyond the core
    count = np.ceil(2 * core * ripple.wavenumber / (2 * np.pi)) + 8
    half = (count + 0.5) * np.pi / ripple.wavenumber
    box = _box(chain, half, max(10, 2 * ripple.wavenumber))
    solved = newton(box, fourier(phi, first.half, np.clip(box.x, -first.half, first.half)), most=30)
    if not solved.converged or not 0.3 < np.abs(solved.phi).max() / np.abs(phi).max() < 3:
        return f"Newton's method did not reach a pulse from that of beads of the whole mass ({solved.residual:.1e})"
    return _smallest(chain, box, solved, ripple, core)


def velocities(found: Found):
    """Velocities (P, N) of the sites at the box's places x = n - c t, in units of c times the length of strains.

    m_j v_j' = F_j(phi_j(x)) - F_{j-1}(phi_{j-1}(x - 1)), and the far field is at rest.
    """
    box, chain = found.box, found.box.chain
    force = np.fft.fft(chain.force(found.solved.phi), axis=1)
    k = np.where(box.k == 0, 1, box.k)
    hat = (force - np.roll(force, 1, axis=0) * np.exp(-1j * k)) / (1j * k * heaviness(chain, box.k))
    hat[:, 0] = found.solved.phi.mean() * box.points
    hat[:, box.points // 2] = 0
    return np.fft.ifft(hat, axis=1).real


def error_of(found: Found) -> float:
    """Estimated error of the strains, over their peak: a Newton step for the defect on a grid twice as fine."""
    box, chain, phi = found.box, found.box.chain, found.solved.phi
    N = box.points
    fine = fourier(phi, box.half, -box.half + np.arange(2 * N) * box.half / N)
    k = 2 * np.pi * np.fft.fftfreq(2 * N, box.half / N)
    F, own = np.fft.fft(chain.force(fine), axis=1), np.fft.fft(fine, axis=1)
    B = response(chain, k) / np.where(k == 0, 1, k**2)
    left = own - np.einsum("ijk,jk->ik", B, F)
    total = heaviness(chain, np.zeros(1)).mean()
    left[:, 0] = own[:, 0].mean() + F[:, 0] - (1 + 1 / total) * F[:, 0].mean()
    left[:, N] = 0
    defect = np.fft.ifft(left, axis=1).real
    J = found.solved.jacobian
    coarse = box.unknowns(defect[:, ::2])
    step = np.linalg.solve(J, np.append(coarse, np.zeros(len(J) - len(coarse))))[: len(coarse)]
    top = np.abs(phi).max()
    cut = np.exp(-min(decay(chain) * found.core, 700)) if chain.K2.any() else 0.0
    return float((np.abs(step).max() + np.abs(defect).max()) / top + cut + 4 * np.finfo(float).eps)
