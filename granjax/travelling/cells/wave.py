"""Solvers for waves of chains with a cell of several sites, with and without a ripple."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...profiles.fourier import MOST, Box, Chain, Solved, fourier, newton, newton_with
from .guess import struck, uniform
from .tail import Fit, Ripple, decay, drift_row, fit, margin, nearest, ripple_row, ripples, tail

# The points per site of a first box.
POINTS = 5
# The decay lengths of the core after which only the ripple remains.
DEEP = 29.0
# The same where there is no ripple.
DEEPER = 35.0
# The speed, over the sound speed, from which the search starts where it fails at the given speed.
SLOW = 1.06
# The ripple, over the peak, above which the wave is also followed from another one: ripples that
# were not the smallest were above 0.076.
LOUD = 0.07
# The speed of that slower wave, over the sound speed.
QUIET = 1.1
# The first step from there, over that speed.
PACE = 0.04
# The part of the differences of the masses at which the search starts, and its first step.
ALMOST_EQUAL = 0.1
# The factor between two steps that follow each other.
GROWN = 1.3
# The shortest of these steps, as a part of the masses' differences or of the speed.
SHORTEST = 0.003
# The changes of a box's half-length that are tried, since there is no wave near some lengths.
SHIFTS = (0.0, 0.13, -0.13, 0.3, -0.3)
# The gain, as a ratio of two ripples, that is worth a change.
GAIN = 0.97
# The speed, over the sound speed, beyond which no wave is searched for.
FASTEST = 8.0
# The largest strain, over the peak, that a wave without ripple has at the ends of a first box.
FLAT = 0.05
# The number of places at which the width of a wave is searched for.
WIDTHS = 1001
# The ripple, over the peak, below which there is none.
SILENT = 1e-11
# The misfit of a ripple, over the peak, above which the box holds other pulses: of ripples it was
# below 5e-6, of pulses above 0.19.
UNEVEN = 1e-3
# The largest of the highest harmonics, over the largest of all, at which a grid is fine enough.
RESOLVED = 1e-12
# What is said of a box that holds other pulses.
TRAIN = "the search came to a train of pulses, which does not say that there is none"


class Lost(Exception):
    """Raised with the reason why no wave was found."""


class Found(NamedTuple):
    """A wave in the chain's units; without a single linear wave, `ripple` and `tail` are `None`."""

    solved: Solved
    ripple: Ripple | None
    tail: Fit | None
    core: float
    waves: int


def on_a_box(chain: Chain) -> Found:
    """Find the nanopteron with the smallest ripple, in a chain with a stiffness at rest.

    The periodic box joins the wave's two tails. The ripple's amplitude a depends on the box's
    half-length L as 1/a^2 = A + B cos 2kL + C sin 2kL. **Raises** `Lost`.
    """
    try:
        found = _at_once(chain)
    except Lost as lost:
        found = None
        why = lost
    if found and (found.tail is None or np.abs(found.tail.amplitude) < LOUD * found.solved.top):
        return found
    for search in (_from_slower, _from_equal):
        try:
            other = search(chain)
        except Lost:
            continue
        if found and np.abs(other.tail.amplitude) > GAIN * np.abs(found.tail.amplitude):
            return found
        return other
    if found is None:
        raise why
    return found


def _laid_out(chain):
    # Return the linear waves, the core's half-width and the box's half-length.
    waves = ripples(chain)
    core = min((DEEP if waves else DEEPER) / decay(chain), 220.0)
    half = core + 3 * 2 * np.pi / waves[0].wavenumber if waves else core
    if 2 * half * POINTS * len(chain.masses) > MOST:
        raise Lost(
            f"it takes a box of {2 * half:.3g} sites, for its core or for its ripple, which is too long"
        )
    if margin(chain) > FASTEST:
        raise Lost(
            f"at {margin(chain):.3g} times the speed of sound the chain is almost without a stiffness at rest, and "
            "the wave is beyond this method's reach; leave out the precompression"
        )
    return waves, core, half


def _at_once(chain):
    waves, core, half = _laid_out(chain)
    return _finished(chain, _started(chain, half), waves, core)


def _from_slower(chain):
    part = QUIET / margin(chain)
    if part > 1:
        raise Lost("there is no slower wave")
    return _along(chain, chain.faster, part, PACE * part)


def _from_equal(chain):
    if not np.ptp(chain.masses):
        raise Lost("the masses are equal")
    blended = lambda part: chain._replace(masses=1 + part * (chain.masses - 1))
    return _along(chain, blended, ALMOST_EQUAL, ALMOST_EQUAL)


def _along(chain, chain_at, part, step):
    # Follow the smallest ripple to chain_at(1): it is continuous, and a search at one place may
    # miss it.
    waves, core, _ = _laid_out(chain)
    if len(waves) != 1:
        raise Lost("not one linear wave keeps pace with it")
    found = _at_once(chain_at(part))
    while part < 1:
        goal = min(part + step, 1.0)
        try:
            found = _next(chain_at(goal), found)
        except Lost:
            step = step / 2
            if step < SHORTEST:
                raise
        else:
            part = goal
            step = GROWN * step
    return _finished(chain, found.solved, waves, core)


def _next(chain, last):
    waves, core, least = _laid_out(chain)
    if not last.waves == len(waves) == 1:
        raise Lost("another linear wave keeps pace with it")
    k = waves[0].wavenumber
    # As many waves of the ripple as before, less those that the box can spare.
    half = last.solved.box.half * last.ripple.wavenumber / k
    half -= max(0, np.floor((half - least) * k / np.pi)) * np.pi / k
    for shift in SHIFTS:
        solved = _again(chain, last.solved, half + shift, POINTS)
        if solved.converged and 0.9 < solved.top / last.solved.top < 1.6:
            return _smallest(chain, solved, waves[0], core)
    raise Lost("the wave beside it was lost")


def _finished(chain, solved, waves, core):
    begun = _unresolved(solved.phi)
    for refined in range(4):
        worst = _unresolved(solved.phi)
        # More points hardly improve the resolution where the law is not smooth.
        slow = refined == 2 and worst > 1e-2 * begun
        box = solved.box
        if worst < RESOLVED or slow or 1.5 * box.points * len(chain.masses) > MOST:
            break
        before = solved.top
        solved = _again(chain, solved, box.half, 1.5 * _density(box))
        if not (solved.converged and 0.6 < solved.top / before < 1.6):
            raise Lost("the wave was lost on a finer grid")
    if len(waves) != 1:
        return Found(solved, None, None, core, len(waves))
    return _smallest(chain, solved, waves[0], core)


def _begun(chain):
    try:
        return uniform(chain)
    except (ValueError, RuntimeError) as error:
        raise Lost(str(error)) from None


def _rest(solved):
    return np.abs(solved.phi[:, 0]).max() / solved.top


def _density(box):
    return box.points / box.half / 2


def _box(chain, half, density):
    return Box(chain, half, 2 * int(np.ceil(half * density)))


def _again(chain, last, half, density):
    box = _box(chain, half, density)
    before = last.box.half
    return newton(box, fourier(last.phi, before, np.clip(box.x, -before, before)))


def _unresolved(phi):
    hat = np.abs(np.fft.rfft(phi, axis=1))
    return hat[:, int(0.9 * hat.shape[1]) :].max() / hat.max()


def _started(chain, half):
    try:
        return _turned_on(chain, half)
    except Lost as lost:
        if not margin(chain) > 1.05 * SLOW:
            raise
        least = SLOW / margin(chain)
        slow = chain.faster(least)
        try:
            begun = _turned_on(slow, half + DEEP / decay(slow) - DEEP / decay(chain))
        except Lost:
            raise lost from None
        solved, part = _followed(chain.faster, begun, least, 0.05, 0.01, (0.9, 2.5))
        if part < 1:
            raise
        return solved


def _turned_on(chain, half):
    begun = _begun(chain)

    def blended(part):
        masses = (1 - part) * chain.total + part * chain.masses
        if chain.resonator is None or not part:
            return chain._replace(masses=masses, resonator=None)
        # The resonators swing against their beads at the final frequency for every part.
        nu, kappa = chain.resonator
        kappa = part * kappa * (1 + (1 - part) * nu)
        return chain._replace(masses=masses, resonator=(part * nu, kappa))

    box = _box(blended(0.0), half, POINTS)
    start = begun.at(box.x)
    solved = newton(box, start)
    height = solved.top
    # A uniformly compressed chain is a solution too and has to be excluded.
    if not (solved.converged and 0.2 < height / np.abs(start).max() < 5 and _rest(solved) < FLAT):
        raise Lost(
            f"Newton's method did not reach a wave of the chain of equal masses (residual {solved.residual:.1e})"
        )
    step = 1.0 if np.ptp(chain.masses) < 0.5 and chain.resonator is None else 0.25
    solved, part = _followed(blended, solved, 0.0, step, 0.02, (0.6, 1.6))
    if part < 1:
        raise Lost(
            f"the wave of equal masses was lost when {part:.0%} of what differs from them was turned on. The "
            "search failed, which does not say that there is none; the ripple may be as strong as the wave"
        )
    return solved


def _followed(chain_at, solved, part, step, least, change):
    """Follow a wave to chain_at(1), or as far as it goes; also return the part reached.

    `change`: the least and the largest factor by which the peak may change in a step.
    """
    half = solved.box.half
    while part < 1:
        step = min(step, 1 - part)
        trial = _again(chain_at(part + step), solved, half, POINTS)
        moved = trial.top / solved.top
        if trial.converged and change[0] < moved < change[1] and _rest(trial) < 1:
            part = part + step
            solved = trial
            step = 1.5 * step
        elif step > least:
            # A box whose length fits the ripple has no wave, so the length is changed.
            step = step / 2
            half = half + 0.13
        else:
            break
    return solved, part


def _smallest(chain, solved, ripple, core):
    k = ripple.wavenumber
    density = _density(solved.box)
    found = fit(solved, ripple, core)
    silent = np.abs(found.amplitude) < SILENT * solved.top
    for _ in range(0 if silent else 3):
        # Three lengths over one period of the ripple about the best so far. Near some lengths there
        # is no wave.
        best = solved.box.half
        lengths = [best]
        sizes = [np.abs(found.amplitude)]
        for part in (1, -1, 0.5, -0.5):
            if len(lengths) == 3:
                break
            at = _again(chain, solved, best + part * np.pi / (3 * k), density)
            if at.converged:
                lengths.append(at.box.half)
                sizes.append(np.abs(fit(at, ripple, core).amplitude))
        if len(lengths) < 3:
            break
        phase = 2 * k * np.array(lengths)
        A, B, C = np.linalg.solve(
            np.stack([np.ones(3), np.cos(phase), np.sin(phase)], 1), 1 / np.array(sizes) ** 2
        )
        half = (
            best
            + (np.arctan2(C, B) / (2 * k) - best + np.pi / (2 * k)) % (np.pi / k)
            - np.pi / (2 * k)
        )
        at = _again(chain, solved, half, density)
        if not at.converged:
            break
        size = fit(at, ripple, core)
        gain = np.abs(size.amplitude) / np.abs(found.amplitude)
        if gain < 1:
            solved, found = at, size
        if gain > GAIN:
            break
    if nearest(solved.box.x, solved.phi, found.wavenumber, core)[1] > UNEVEN * solved.top:
        raise Lost(TRAIN)
    return Found(solved, ripple, found, core, 1)


def without_tail(chain_at: Callable, low: float, high: float, parts=(0.5, 0.2, 0.8)) -> Found:
    """Find a wave without a ripple and the parameter in [low, high] at which it exists.

    `chain_at`: parameter to `Chain`. With a stiffness at rest the ripple's amplitude must vanish;
    without one, the drift or the gap between neighbours behind the pulse. `parts`: starting points,
    as parts of the interval. **Raises** `Lost`.
    """
    for part in parts:
        try:
            return _without_tail(chain_at, low, high, low + part * (high - low))
        except Lost as lost:
            why = lost
    raise why


def _without_tail(chain_at, low, high, p):
    chain = chain_at(p)
    box, phi, speed, row, core = (_with_ripple if chain.stiffness.any() else _simulated)(chain)
    # First at the speed of the simulated pulse, then at that of the wave.
    for goal in dict.fromkeys([speed, 1.0]):

        def box_of(p, goal=goal):
            there = chain_at(p).faster(goal)
            if len(there.masses) != len(chain.masses):
                raise Lost(
                    f"Newton's method went to {p:.6g}, where the sites of the cell are equal"
                )
            return Box(there, box.half, box.points)

        solved = newton_with(box_of, row, phi, p, 0.2 * (high - low))
        if not solved.converged:
            raise Lost(f"Newton's method stopped at a residual of {solved.residual:.1e}")
        p = solved.parameter
        phi = solved.phi
    if not (low <= p <= high and solved.top > 0):
        raise Lost(f"Newton's method went to {p:.6g}, outside of the interval")
    box = box_of(p)
    if np.abs(tail(box.x, phi, core)[1]).max() > UNEVEN * solved.top:
        raise Lost(TRAIN)
    return Found(solved._replace(box=box), None, None, core, 0)


def _with_ripple(chain):
    begun = on_a_box(chain)
    if begun.ripple is None:
        raise Lost(
            f"{begun.waves} linear waves keep pace with it, and one parameter can silence one"
        )
    row = lambda box: ripple_row(box, ripples(box.chain)[0], begun.core)
    return begun.solved.box, begun.solved.phi, 1.0, row, begun.core


def _simulated(chain):
    found = struck(chain, float(_begun(chain).at(np.zeros(1)).mean()))
    if found is None:
        raise Lost("a blow made no pulse that could be followed")
    speed, width, on = found
    box = Box(chain, width + 7.0, 2 * int(8 * (width + 7.0)))
    # Where the mirror is a contact, the pulse leaves a gap, otherwise a drift.
    gap = lambda box: np.eye(1, len(box.x) * len(chain.masses))[0]
    row = gap if (chain.mirror - 1) % len(chain.masses) == 0 else drift_row
    return box, on(box), speed, row, width + 5.0


def of_one_site(chain: Chain) -> Found:
    """Find the wave of equal beads without a stiffness at rest.

    With resonators it is that of the smallest ripple. **Raises** `Lost`.
    """
    shape = _begun(chain).shape
    on = lambda x: np.asarray(shape.at("strain", x))
    x = np.linspace(0, float(shape.end), WIDTHS)
    core = float(x[np.argmax(np.abs(on(x)) < 1e-2 * np.abs(on(0.0)))]) + 5.0
    if chain.resonator is None:
        half = core + 2.0
        density = 8
        ripple = None
    else:
        nu, kappa = chain.resonator
        ripple = Ripple(float(np.sqrt(kappa / chain.unit * (1 + nu) / nu)), np.ones(1, complex))
        # The half-length is as far as possible from those that fit the ripple, four wavelengths
        # beyond the core.
        count = np.ceil(2 * core * ripple.wavenumber / (2 * np.pi)) + 8
        half = (count + 0.5) * np.pi / ripple.wavenumber
        density = max(10, 2 * ripple.wavenumber)
    box = _box(chain, half, density)
    solved = newton(box, on(box.x)[None], most=30)
    if not solved.converged or not 0.3 < solved.top / np.abs(on(0.0)) < 3:
        raise Lost(
            f"Newton's method did not reach a pulse from that of beads of the whole mass ({solved.residual:.1e})"
        )
    if ripple is None:
        return Found(solved, None, None, core, 0)
    return _smallest(chain, solved, ripple, core)


def error_of(found: Found) -> float:
    """Estimate the strains' relative error by a Newton step for the defect on a finer grid."""
    box, phi, *_ = found.solved
    chain = box.chain
    N = box.points
    fine = fourier(phi, box.half, -box.half + np.arange(2 * N) * box.half / N)
    F = np.fft.fft(chain.bonds(fine)[0], axis=1)
    own = np.fft.fft(fine, axis=1)
    own[:, 0] = own[:, 0].mean()
    left = own - np.einsum("ijk,jk->ik", chain.symbol(box.half, 2 * N), F)
    defect = np.fft.ifft(left, axis=1).real
    J = found.solved.jacobian
    coarse = box.unknowns(defect[:, ::2])
    step = np.linalg.solve(J, np.append(coarse, np.zeros(len(J) - len(coarse))))[: len(coarse)]
    top = found.solved.top
    cut = np.exp(-min(decay(chain) * found.core, 700)) if chain.stiffness.any() else 0.0
    shown = (np.abs(step).max() + np.abs(defect).max()) / top
    if _unresolved(phi) > RESOLVED:
        # Where contacts open the error falls slowly; a grid twice as fine shows 4/5 of it or more.
        shown *= 1.5
    return float(shown + cut + 4 * np.finfo(float).eps)
