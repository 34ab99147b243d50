"""Transmission of a finite dimer chain to a rigid wall, and its extrema over the mass ratio."""

import numpy as np
from jaxtyping import Float

from ..base.checks import positive, refuse, tolerance, whole
from ..base.types import Count, Parameter, Scalar
from ..results import Result, array, note
from .decay import decay_rate
from .lanes import LANES, checked_ratios, peak_forces

# the fewest moving beads of a chain
LEAST_BEADS = 3
# the time per bead of the slowest pulse, that of the first resonance
SLOWEST = 1.35
# the time in which the force of the pulse rises and falls
LEAST_TIME = 5.0
# between these contacts the pulse has found its form, and no later pulse has passed it yet
DEPTHS = 40, 100
# decimal digits that distinguish two mass ratios
DIGITS = 12
# ratios on each side of a maximum at which the decay is computed; it touches zero as a parabola
LOOKED = 8
# decay at a maximum over that at its minima: below 0.1 at zeros, above 0.4 at ripples (31 to 201
# beads)
TOUCHES = 0.2


class Transmission(Result):
    """The result of `transmission`."""

    mass_ratio: Float[np.ndarray, " mass_ratio"] = array("The mass ratios.", "1")
    peak_force: Float[np.ndarray, " mass_ratio"] = array(
        "The largest force on the wall.", "A^(2/5) (m v^2)^(3/5)"
    )
    transmission: Float[np.ndarray, " mass_ratio"] = array(
        "The largest force on the wall over that of the monomer.", "1"
    )
    reference: float = note("The peak force of the monomer.", name="monomer_force")
    beads: int = array("The number of beads.", static=True)
    run_time: float = array(
        "The time until which the wall was watched.", "(m^2/(A^2 v))^(1/5)", static=True
    )

    @property
    def outcome(self) -> str:
        lost = np.count_nonzero(np.isnan(self.transmission))
        failed = f"; {lost} of them failed" if lost else ""
        return f"Chains of {self.beads} beads and a wall at {len(self.mass_ratio)} mass ratios{failed}."


class Extrema(Result):
    """The result of `refine`: minima and maxima of the transmission, in ascending ratios.

    Between two resonances lies an anti-resonance, where the leading pulse does not decay.
    """

    resonances: Float[np.ndarray, " resonance"] = array("The mass ratios of the minima.", "1")
    resonance_transmission: Float[np.ndarray, " resonance"] = array(
        "The transmission at the minima.", "1"
    )
    anti_resonances: Float[np.ndarray, " anti_resonance"] = array(
        "The mass ratios of the maxima.", "1"
    )
    anti_resonance_transmission: Float[np.ndarray, " anti_resonance"] = array(
        "The transmission at the maxima.", "1"
    )
    local_extrema: Float[np.ndarray, " local_extremum"] = array(
        "Other minima and maxima, ripples of a finite chain.", "1"
    )
    local_transmission: Float[np.ndarray, " local_extremum"] = array(
        "The transmission at the other extrema.", "1"
    )

    @property
    def outcome(self) -> str:
        return (
            f"Found resonances: {len(self.resonances)}, anti-resonances: {len(self.anti_resonances)}, "
            f"other local extrema: {len(self.local_extrema)}."
        )


def transmission(
    ratios: Parameter, beads: Count = 101, *, run_time: Scalar | None = None
) -> Transmission:
    r"""Compute the largest force of a struck dimer chain on a wall, relative to the monomer's.

    T(epsilon) = max_t F_wall(t; epsilon)/max_t F_wall(t; 1), so T(1) = 1. The wall at the far end
    is one more contact with A = 1. Any pulse counts: between epsilon = 0.55 and 0.594 at 101 beads
    it comes from the second pulse, so that the deepest minimum is a cusp.

    **Arguments:**

    - `ratios`: mass ratios light over heavy in (0, 1], (n,).
    - `beads`: N >= 3 moving beads. A wall also stands behind bead 0; only its rebound meets that.
    - `run_time`: how long the wall is watched [in units (m^2/(A^2 v))^(1/5)]. `None` takes 1.5 N +
      10, when the leading pulse has been reflected at every ratio; at least 1.35 N + 5, when it has
      reached the wall.

    Fixed steps with h omega_max = 1/2: relative error of T at 101 beads 1e-6, near 0.587 up to
    6e-6.

    **Returns:** `Transmission`; NaN for a run that did not complete. **Raises** ValueError for
    ratios outside (0, 1], N < 3 or a shorter run. Typical: N = 101, T = 0.21 at 0.595.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).

    **Example:**

    >>> sweep = gx.resonance.transmission([0.5, 0.7, 1.0], beads=5)
    >>> print(sweep.transmission.round(3))
    [0.899 0.984 1.   ]
    """
    ratios = checked_ratios(ratios)
    beads = whole("beads", beads, LEAST_BEADS, "A dimer chain between walls.")
    # the pulse takes a time of 0.93 per bead at epsilon = 0.05, 1.2 in the monomer
    run_time = 1.5 * beads + 10 if run_time is None else float(positive("run_time", run_time))
    least = SLOWEST * beads + LEAST_TIME
    if run_time < least:
        refuse(
            "run_time",
            f"at least {least:g}, when the pulse has reached the wall",
            f"{run_time:g}",
            "A wall that nothing has reached feels no force.",
        )
    lanes = ratios if (ratios == 1).any() else np.append(ratios, 1.0)
    forces = peak_forces(lanes, beads, "fixed", (beads,), run_time)[0]
    reference = float(forces[lanes == 1][0])
    forces = forces[: len(ratios)]
    return Transmission(ratios, forces, forces / reference, reference, beads, run_time)


def refine(sweep: Transmission, *, accuracy: Scalar = 1e-4) -> Extrema:
    """Refine the local extrema of a transmission over the mass ratio, between grid neighbours.

    The brackets shrink by 2/9 a round, with eight ratios in each; a cusp is no harder than a smooth
    extremum. An extremum narrower than the grid is missed.

    - A maximum is an anti-resonance if the decay rate of the leading pulse, between contacts 40 and
      100 of a long chain, touches zero between the minima beside it: if it falls below a fifth of
      its values at these. So is the ratio 1, if it is the largest and lies above its neighbour.
    - The deepest minimum between two anti-resonances is the resonance.
    - All others are local extrema, ripples of a finite chain.

    These maxima are not yet the zeros of the asymptotic decay rate; see `anti_resonance`.

    **Arguments:** `sweep`: from `transmission`; `accuracy`: half-width of the final brackets.

    **Returns:** `Extrema`. **Raises** ValueError for fewer than three different ratios or NaN
    transmissions.
    """
    accuracy = tolerance("accuracy", accuracy, 1, 1e-4)
    # ratios that differ by rounding are one ratio; their transmissions differ by rounding too
    _, first = np.unique(np.round(sweep.mass_ratio, DIGITS), return_index=True)
    ratios = np.asarray(sweep.mass_ratio)[first]
    values = np.asarray(sweep.transmission)[first]
    if len(ratios) < 3:
        refuse(
            "sweep",
            "at least three different mass ratios",
            f"{len(ratios)}",
            "An extremum has two neighbours.",
        )
    if not np.isfinite(values).all():
        refuse(
            "sweep",
            "a transmission at every ratio",
            f"{np.count_nonzero(~np.isfinite(values))} that are NaN",
        )
    rise = np.sign(np.diff(values))
    # the first of equal neighbours counts
    signs = np.where(rise[1:] == rise[:-1], 0, rise[:-1])
    found = np.flatnonzero(signs) + 1
    signs = signs[signs != 0]
    x = ratios[found]
    T = values[found]
    if len(found):
        x, T = _narrowed(sweep, ratios[found - 1], ratios[found + 1], signs, accuracy)
    if ratios[-1] == 1 and values[-1] > values[-2]:
        x = np.append(x, 1.0)
        T = np.append(T, values[-1])
        signs = np.append(signs, 1)
    lowest, highest = _named(x, T, signs, ratios[[0, -1]])
    others = ~(lowest | highest)
    return Extrema(x[lowest], T[lowest], x[highest], T[highest], x[others], T[others])


def _named(x, T, signs, ends):
    highest = signs > 0
    lowest = np.zeros(len(x), bool)
    # each maximum except the monomer's, up to the minima beside it or the ends of the grid
    tops = np.flatnonzero(highest & (x < 1))
    if not (signs < 0).any():
        return lowest, highest
    edges = np.concatenate([[ends[0]], x, [ends[1]]])
    within = (
        np.linspace(edges[tops], x[tops], LOOKED)[:-1],
        np.linspace(x[tops], edges[tops + 2], LOOKED),
    )
    places = np.concatenate(within)
    rates = decay_rate(places.ravel(), DEPTHS).reshape(places.shape) if len(tops) else places
    beside = np.stack(
        [np.where(tops > 0, rates[0], np.inf), np.where(tops < len(x) - 1, rates[-1], np.inf)]
    )
    highest[tops] = rates.min(axis=0) < TOUCHES * beside.min(axis=0)
    # groups of minima between anti-resonances
    groups = np.cumsum(highest)
    for group in np.unique(groups[signs < 0]):
        members = np.flatnonzero((groups == group) & (signs < 0))
        lowest[members[np.argmin(T[members])]] = True
    return lowest, highest


def _narrowed(sweep, low, high, signs, accuracy):
    # the extrema within brackets, and the transmission there; each bracket is one chunk of lanes,
    # whose points share a step: its error does not order them
    each = np.arange(len(low))
    while True:
        points = np.linspace(low, high, LANES + 2, axis=1)
        inner = points[:, 1:-1].ravel()
        forces = peak_forces(inner, sweep.beads, "fixed", (sweep.beads,), sweep.run_time)
        forces = forces.reshape(-1, LANES)
        best = np.argmax(signs[:, None] * forces, axis=1)
        low = points[each, best]
        middle = points[each, best + 1]
        high = points[each, best + 2]
        if (high - low).max() <= 2 * accuracy:
            return middle, forces[each, best] / sweep.reference
