"""Harmonics of a breather that meet the waves of its lattice."""

import jax
import numpy as np

from ..checks import refuse
from ..linear import bands, normal_modes

# relative distance to a frequency of the finite lattice that is a resonance by itself
MEETS = 1e-9
# neighbouring extended modes this much closer than the spectrum's width belong to one band
SPACING = 8


def bands_of(lattice):
    """Intervals of omega that waves fill, (bands, 2), and the discrete spectrum.

    Of the unit cell where there is one; else of the extended modes of the finite lattice: runs of neighbours closer
    than 8 mean spacings, of modes that spread over a fifth of the sites.
    """
    modes = normal_modes(lattice)
    omega = np.asarray(modes.omega)
    try:
        found = bands(lattice)
        return np.stack([np.asarray(found.lower), np.asarray(found.upper)], -1), omega
    except ValueError:
        pass
    shapes = np.concatenate([np.asarray(x).reshape(-1, len(omega)) for x in jax.tree.leaves(modes.modes)]) ** 2
    participation = shapes.sum(0) ** 2 / (shapes**2).sum(0)
    extended = np.sort(omega[participation > len(omega) / 5])
    if not len(extended):
        return np.zeros((0, 2)), omega
    apart = np.flatnonzero(np.diff(extended) > SPACING * (extended[-1] - extended[0]) / len(extended))
    return np.array([[run[0], run[-1]] for run in np.split(extended, apart + 1)]), omega


def resonant_harmonic(lattice, omega, first=1):
    """The least n >= first with n omega in a band, with that band and the nearest frequency of the finite lattice.

    `None` where no harmonic meets a wave.
    """
    intervals, discrete = bands_of(lattice)
    top = max(intervals.max(initial=0.0), discrete.max())
    for n in range(first, int(top / omega) + 1):
        nearest = discrete[np.argmin(np.abs(discrete - n * omega))]
        inside = [(low, high) for low, high in intervals if low * (1 + MEETS) < n * omega < high * (1 - MEETS)]
        if inside or abs(nearest - n * omega) < MEETS * nearest:
            return n, inside[0] if inside else (nearest, nearest), float(nearest)
    return None


def refuse_resonance(lattice, omega, dark):
    """Refuse a frequency one of whose harmonics (of a dark breather from the second on) is a wave of the chain."""
    found = resonant_harmonic(lattice, omega, 2 if dark else 1)
    if found is None:
        return
    n, (low, high), nearest = found
    refuse(
        "omega", f"a frequency whose harmonics lie in gaps, for a {'dark' if dark else 'bright'} breather",
        f"{omega:.6g}", f"n = {n}: {n} omega = {n * omega:.6g} lies in the band {low:.6g} ... {high:.6g}, where waves "
        f"carry energy away; the finite lattice's nearest frequency is {nearest:.6g}. check=False tries all the same.",
    )
