"""The leading pulse in a long dimer chain: peak forces, decay rate, zeros of the rate."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..base.checks import refuse, whole, within
from ..base.types import Parameter, Scalar
from .lanes import LANES, checked_ratios, peak_forces

# beads behind the last contact that is read, so that it does not feel the free end
MARGIN = 12
# a quartic represents the rate within a bracket of this width relative to its centre
FIT_WIDTH = 0.01


def contact_forces(ratios: Parameter, contacts: Parameter) -> Float[np.ndarray, "contacts n"]:
    """Compute the largest contact forces of a long free dimer chain, bead 0 struck with v = 1.

    **Arguments:** `ratios`: light over heavy, in (0, 1], (n,); `contacts`: (c,), from 0; contact n
    lies between the beads n and n + 1, an even one has the heavy bead first.

    Fixed steps with h omega_max = 1/2: relative error about 1e-6 at contact 60.

    **Returns:** a NumPy array (c, n), in units of A^(2/5) (m v^2)^(3/5). **Raises** ValueError for
    ratios outside (0, 1] or a contact that is no whole number. Typical: 0.63955 for the monomer,
    0.30190 at ratio 1/2, contact 20.
    """
    ratios = checked_ratios(ratios)
    bonds = tuple(whole(f"contacts[{i}]", n, 0) for i, n in enumerate(np.atleast_1d(contacts)))
    if not bonds:
        refuse("contacts", "one contact or more", "none")
    beads = max(bonds) + MARGIN
    return peak_forces(ratios, beads, "free", bonds, 1.5 * beads + 10)


def decay_rate(ratios: Parameter, contacts: Sequence[int] = (200, 600)) -> Float[np.ndarray, " n"]:
    """Compute the decay rate of the leading pulse per dimer.

    The rate is -ln(F_b/F_a)/((b - a)/2), F the peak forces at two contacts. It is zero at
    anti-resonances and positive between them, up to the error of the step (1e-9).

    **Arguments:** `ratios`: light over heavy, in (0, 1], (n,); `contacts`: (a, b), a < b, both even
    or both odd, from 0.

    **Returns:** a NumPy array (n,). **Raises** ValueError for ratios outside (0, 1], or contacts
    that are not such a pair. Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606
    (2011).

    **Example:**

    >>> rates = gx.resonance.decay_rate([1.0, 0.5], contacts=(10, 20))
    >>> bool(abs(rates[0]) < 1e-3), round(float(rates[1]), 3)  # a monomer's pulse does not decay
    (True, 0.042)
    """
    pair = np.shape(contacts) == (2,)
    found = [whole(f"contacts[{i}]", n, 0) for i, n in enumerate(contacts)] if pair else ()
    if not pair or not found[0] < found[1] or sum(found) % 2:
        wanted = "two contacts (a, b), a < b, both even or both odd"
        refuse("contacts", wanted, f"{contacts}", "Typical: (200, 600).")
    first, last = contact_forces(ratios, found)
    return -np.log(last / first) / ((found[1] - found[0]) / 2)


def anti_resonance(low: Scalar, high: Scalar, *, contacts: Sequence[int] = (200, 600)) -> float:
    """Find the mass ratio in [low, high] at which the leading pulse does not decay.

    There the asymptotic decay rate touches zero from above. Grids of sixteen ratios bracket the
    minimum within 1 % of its centre, and a quartic through the last grid gives it.

    **Arguments:** `low` < `high`, in (0, 1], around one anti-resonance; `contacts`: as in
    `decay_rate`; further down the chain is closer to the limit.

    **Returns:** a float, good to about 1e-6 with the default contacts (0.342846, 0.154751,
    0.090128; 1, the monomer, only as the end of the interval). **Raises** ValueError for an
    interval outside (0, 1] or empty, RuntimeError if the rate has no minimum inside.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011).

    **Example:**

    >>> round(gx.resonance.anti_resonance(0.3, 0.4, contacts=(20, 40)), 2)  # 0.342846 far down the chain
    0.35
    """
    low, high = (
        float(within(name, x, 0, 1, open_low=True, remedy="The ratio is light over heavy."))
        for name, x in (("low", low), ("high", high))
    )
    if not low < high:
        refuse(
            "high",
            f"a mass ratio above low = {low:g}",
            f"{high:g}",
            "Give the interval from small to large.",
        )
    while True:
        ratios = np.linspace(low, high, 2 * LANES)
        rates = decay_rate(ratios, contacts)
        best = int(np.argmin(rates))
        if best == len(ratios) - 1 and high == 1:
            return 1.0
        if best in (0, len(ratios) - 1):
            raise RuntimeError(
                f"The decay rate has no minimum inside [{low:.6g}, {high:.6g}]: it is lowest at {ratios[best]:.6g}. "
                "Give an interval around an anti-resonance, such as [0.3, 0.4]."
            )
        if high - low <= FIT_WIDTH * (low + high):
            return _vertex(ratios, rates, best)
        low = float(ratios[best - 1])
        high = float(ratios[best + 1])


def _vertex(ratios, rates, best):
    places = np.polynomial.Polynomial.fit(ratios, rates, 4).deriv().roots()
    places = places[np.isreal(places)].real
    return float(places[np.argmin(np.abs(places - ratios[best]))])
