"""`cell_wave`, `tail_free`, and the wave that they return."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...base.checks import positive, refuse
from ...base.types import Count, Numbers, Parameter, Scalar
from ...lattice import Lattice, State
from ...laws import Law
from ...profiles import places
from ...profiles.fourier import fourier
from ...profiles.highest import highest
from ...results import Result, array, note
from .cell import chain_of, repeated_in
from .resonator import Resonator
from .tail import group, margin, nearest, periodic
from .wave import SILENT, Lost, error_of, of_one_site, on_a_box, without_tail

# The least speed, over the sound speed, at which a box holds the wave.
LEAST_MARGIN = 1.004
# The ripple, over the peak, above which there is no distinct pulse.
LOUDEST = 0.5
# The relative distance of a mass ratio from an anti-resonance within which the latter's wave is
# returned.
NEAR = 1e-5


class CellWave(Result):
    """A wave of a chain with P sites in a cell: contact n has the strain phi_{n mod P}(n - c t).

    Contact n lies between the sites n and n + 1. xi = n - c t counts sites, of contacts and of
    beads, as in `Wave`. A wave with a mirror symmetry has it at xi = 0 of the contacts. `strain`
    and `velocity` accept any place: beyond the box of the solution a ripple of one wave continues,
    with a misfit that `error` includes.
    """

    speed: float = note("The speed c in sites (not cells) per time.", "1/s")
    masses: Numbers = array("The masses of the smallest cell.", "kg", "place")
    amplitude: float = note("The largest absolute strain.", "m")
    ripple: float = note(
        "The largest strain of the linear wave that keeps pace; zero for a wave without loss, "
        "NaN where several keep pace.",
        "m",
    )
    wavenumber: float | None = note(
        "The wave number of the ripple per site, as measured in the tail.", "rad"
    )
    linear_wavenumber: float | None = note(
        "The wave number of the linear wave, omega(k) = c k; the difference is quadratic in the "
        "ripple.",
        "rad",
    )
    parameter: float | None = array("The parameter of `tail_free`.")
    energy: float = note(
        "The energy, averaged over the wave's places in a cell; NaN with a ripple, whose energy "
        "is unbounded.",
        "J",
    )
    residual: float = array("The residual of the equations, over the amplitude.")
    error: float = note("The estimated error of the strains.", "m")
    radiation: float = note(
        "The power that the wave loses if it is launched without its ripple, to second order in "
        "the ripple; NaN where unknown: several ripples, resonators.",
        "W",
    )
    xi: Numbers = array("The places of the table.", "1", "xi")
    strains: Numbers = array("The strains of the table.", "m", "place xi")
    velocities: Numbers = array("The velocities of the table.", "m/s", "place xi")
    resonator: Resonator | None = array("The resonator in each bead.")
    # The half-width of the core, beyond which only the ripple remains.
    _core: float = eqx.field(static=True, default=0.0)
    # The number of linear waves that keep pace; the relative shift of the masses from those given.
    _waves: int = eqx.field(static=True, default=0)
    _off: float = eqx.field(static=True, default=0.0)

    @property
    def outcome(self) -> str:
        """Whether the wave travels without loss."""
        if np.isnan(self.ripple):
            return (
                f"A wave in step with {self._waves} linear waves; its ripple depends on the periodic box and is "
                "not the smallest possible."
            )
        if self.ripple:
            return (
                f"A wave with a ripple of {self.ripple / self.amplitude:.2g} of its peak, wave number "
                f"{self.wavenumber:.7g} (linear {self.linear_wavenumber:.7g}): alone it would lose energy."
            )
        at = "" if self.parameter is None else f" at the parameter {self.parameter:.12g}"
        told = f"A wave that travels without loss{at}: no ripple."
        if self._off:
            near = self.masses.min() / self.masses.max()
            told += f" The masses are those of the anti-resonance, {near:.12g}, {self._off:+.1e} from what was given."
        return told

    def strain(self, xi: Parameter, bond: Count = 0) -> Float[np.ndarray, "..."]:
        """Return the compression [m] of the cell's contact `bond` at places xi of any shape."""
        return self._at(self.strains, xi, bond)

    def velocity(self, xi: Parameter, site: Count = 0) -> Float[np.ndarray, "..."]:
        """Return the velocity [m/s] of the cell's bead `site` at places xi of any shape."""
        return self._at(self.velocities, xi, site)

    def state(self, sites: Count, centre: Scalar | None = None) -> State:
        """Return displacements and velocities of `sites` sites, with xi = 0 at contact `centre`.

        Site 0 is the first of the cell. `None` is the middle of the chain, (sites - 2)/2. The last
        bead is at its place, and the beads behind the wave have moved: this is meant for free ends.
        With resonators the fields are dicts of `"bead"` and `"resonator"`.
        """
        xi = places(sites, centre)
        u = np.zeros(sites)
        v = self._along(self.velocities, xi)
        u[:-1] = np.cumsum(self._along(self.strains, xi[:-1])[::-1])[::-1]
        if self.resonator is None:
            return State(u, v)
        velocity, stretch = swinging(self.velocities, self.xi, self.speed, self.resonator)
        inner = u - self._along(stretch, xi), self._along(velocity, xi)
        return State(*({"bead": x, "resonator": y} for x, y in zip((u, v), inner)))

    def _along(self, table, xi):
        out = np.empty(len(xi))
        P = len(self.masses)
        for j in range(P):
            out[j::P] = self._at(table, xi[j::P], j)
        return out

    def _at(self, table, xi, j):
        x = np.asarray(xi, float)
        j = j % len(self.masses)
        half = -self.xi[0]
        inside = np.abs(x) <= half
        own = fourier(table[j : j + 1], half, np.where(inside, x, 0.0).ravel()).reshape(x.shape)
        if self.wavenumber is None or inside.all():
            return np.where(inside, own, 0.0)
        ripple, _ = nearest(self.xi, table[j : j + 1], self.wavenumber, self._core)
        beyond = periodic((x - np.sign(x) * half).ravel(), self.wavenumber) @ ripple
        return np.where(inside, own, beyond.reshape(x.shape))


def swinging(velocities, xi, speed, resonator):
    """Return tables of the resonators' velocities and of the beads' displacements from them."""
    k = 2 * np.pi * np.fft.fftfreq(len(xi), xi[1] - xi[0])
    square = float(resonator.mass / resonator.stiffness)
    inner = np.fft.fft(velocities, axis=1) / (1 - square * speed**2 * k**2)
    stretch = -square * speed * 1j * k * inner
    return np.fft.ifft(inner, axis=1).real, np.fft.ifft(stretch, axis=1).real


def cell_wave(
    law: Law | Lattice,
    masses: Parameter | None = None,
    *,
    speed: Scalar,
    resonator: Resonator | None = None,
) -> CellWave:
    r"""Compute the wave of a given speed in a chain that repeats with a cell of P sites.

    Bond n, between the sites n and n + 1, has the law of place n mod P: parameters of `law` are
    numbers or arrays (P,).

    *With a stiffness at rest* (precompressed contacts, FPUT, Toda) a supersonic wave keeps pace
    with a linear wave of the optical band, omega(k) = c k. It is a nanopteron: a core on a ripple
    that extends to infinity on both sides. The nanopteron with the smallest ripple that was found
    is returned: above 7 % of the peak there may be a smaller one. `ripple` is its amplitude, half
    of what a wave without a ripple ahead sheds behind: zero means a wave without loss. Newton's
    method solves the Fourier form on a periodic box whose length minimizes the ripple.

    *Without one* (granular chain, F0 = 0) light beads behind a pulse rattle freely. Waves exist
    only at single mass ratios (dimers: 1, 0.342845781150, 0.154751513885, 0.090127769139,
    0.061502072781, ...). At all others every pulse decays (`gx.resonance.decay_rate`), and the call
    is refused. `tail_free` finds these ratios.

    *With a resonator* in every bead, the linear wave is the swing of bead and resonator against
    each other, k = (kappa (1/mu + 1/m))^{1/2}/c without a stiffness at rest (the contacts then open
    and close). Where k is a multiple of 2 pi no contact feels it, and the wave has no ripple.

    **Arguments:** `law` and `masses` (P,) [kg]; or a chain `Lattice` that repeats, whose walls are
    ignored and whose units the result has. `speed`: c, in sites (not cells) per time. `resonator`:
    a `gx.Resonator` in every bead.

    **Returns:** `CellWave`, not differentiable.
    **Raises** ValueError for a speed that is not supersonic, a law without a wave of that speed,
    and several sites without a stiffness at rest away from the anti-resonances; RuntimeError where
    no wave was found, as where the ripple is as strong as the wave. Typical: Toda, masses (1, 0.9),
    1.2 times the speed of sound: ripple 2.6 % of the peak.
    Source: Jayaprakash, Starosvetsky, Vakakis, Phys. Rev. E 83, 036606 (2011); Faver, Wright, SIAM
    J. Math. Anal. 50, 473 (2018); Vainchtein, Starosvetsky, Wright, Perline, Phys. Rev. E 93,
    042210 (2016).

    **Example:**

    >>> wave = gx.travelling.cell_wave(gx.Hertz(), [1.0, 0.342845781150], speed=1.0)  # at an anti-resonance
    >>> round(float(wave.amplitude), 4), float(wave.ripple)
    (0.6545, 0.0)
    """
    speed = float(positive("speed", speed, "Mirror the cell for leftward waves."))
    origin = {}
    if isinstance(law, Lattice):
        if masses is not None:
            refuse("masses", "None beside a lattice, which has its own", f"{masses}")
        law, masses, origin = repeated_in(law)
    chain = chain_of(law, masses, speed, resonator)
    if chain.stiffness.any() or len(chain.masses) == 1:
        _faster_than_sound(chain, speed)
        search = on_a_box if chain.stiffness.any() else of_one_site
        return _recorded(lambda: search(chain), resonator, speed, **origin)
    return _in_vacuum(law, chain, speed, resonator, origin)


def _faster_than_sound(chain, speed):
    over = margin(chain)
    if over < LEAST_MARGIN:
        sound = speed / over
        refuse(
            "speed",
            f"supersonic, at least {LEAST_MARGIN} times the speed of sound, {LEAST_MARGIN * sound:.6g}",
            f"{speed:.6g}",
            f"The speed of sound is {sound:.6g} sites per time; slower waves of this kind radiate.",
        )


def alone_with_resonators(law: Law, mass: Scalar, speed: Scalar, resonator: Resonator) -> CellWave:
    """Compute the wave that leaves no resonator swinging.

    **Raises** ValueError where the stiffness has no such wave, and names the nearest that has.
    """
    # Only after `cell_wave` has checked the numbers.
    nearest = lambda: float(resonator.tail_free(float(speed), float(mass)))
    try:
        wave = cell_wave(law, [mass], speed=speed, resonator=resonator)
    except RuntimeError as lost:
        if np.isclose(resonator.stiffness, nearest(), rtol=1e-9, atol=0):
            raise
        why = str(lost)
    else:
        if not wave.ripple:
            return wave
        share = wave.ripple / wave.amplitude
        why = f"Here the wave has a ripple, of {share:.2g} of its peak: travelling.cell_wave."
    refuse(
        "resonator",
        f"a stiffness of {nearest():.12g} or another `tail_free_stiffness`",
        f"{float(resonator.stiffness):.12g}",
        why,
    )


def _in_vacuum(law, chain, speed, resonator, origin):
    P = len(chain.masses)
    given = chain.given
    if resonator is not None:
        refuse(
            "resonator",
            "None for a cell of several sites without a stiffness at rest",
            repr(resonator),
            "Give equal masses or a precompression.",
        )
    if P > 2 or chain.mirror is None:
        refuse(
            "masses",
            "one or two sites in the smallest cell, mirrored by a bead or a contact",
            f"{P} that have {'no such mirror' if chain.mirror is None else 'one'}",
            "Without a stiffness at rest a wave then needs two parameters to be right; give a precompression.",
        )
    ratio = given.min() / given.max()
    if ratio == 1:
        refuse(
            "law",
            "one law, or a stiffness ratio at which a wave exists",
            "two laws between equal beads",
            "`tail_free(lambda r: (law of ratio r, masses), low, high, speed=...)` finds such ratios.",
        )
    at = lambda p: chain_of(law, np.where(given == given.max(), given, p * given.max()), speed)
    try:
        found = without_tail(at, 0.9 * ratio, 1.1 * ratio, (0.5,))
        near = found.solved.parameter
        nearest = f"the nearest is {near:.12g}"
    except Lost:
        near = np.inf
        nearest = "none is within 10 % of it"
    if abs(near / ratio - 1) > NEAR:
        refuse(
            "masses",
            "a ratio at which a wave travels without loss in a chain without precompression",
            f"{ratio:.12g}",
            f"Here a pulse decays (gx.resonance.decay_rate), since light beads rattle behind it; "
            f"{nearest}. tail_free finds such ratios, a precompression gives a ripple.",
        )
    return _recorded(lambda: found, None, speed, _off=float(near / ratio - 1), **origin)


def tail_free(
    cell: Callable[[Any], Any],
    low: Scalar,
    high: Scalar,
    *,
    speed: Scalar,
) -> CellWave:
    r"""Find the wave that travels without loss, and its parameter between `low` and `high`.

    A cell with a mirror symmetry leaves one condition. With a stiffness at rest the ripple's
    amplitude vanishes. Without one, neighbours far from the pulse must not drift apart (mirror at a
    bead) or keep a gap (at a contact). Newton's method solves for the wave and the parameter
    together.

    **Arguments:** `cell`: parameter -> (law, masses), or a chain `Lattice`, as for `cell_wave`; for
    dimers `lambda ratio: (gx.Hertz(), [1.0, ratio])`. `low` < `high`: an interval around one
    solution. `speed`: c [sites per time].

    **Returns:** `CellWave` with `parameter` (dimers of the sonic vacuum: 0.342845781150, any
    speed).
    **Raises** ValueError for an empty interval and an unsuitable cell; RuntimeError where nothing
    was found.

    **Example:**

    >>> cell = lambda ratio: (gx.Hertz(), [1.0, ratio])
    >>> wave = gx.travelling.tail_free(cell, 0.33, 0.35, speed=1.0)
    >>> round(float(wave.parameter), 6)  # the first anti-resonance of dimers
    0.342846
    """
    speed = float(positive("speed", speed, "Mirror the cell for leftward waves."))
    low = float(low)
    high = float(high)
    if not low < high:
        refuse("high", f"a number above low = {low:g}", f"{high:g}")

    origin = {}

    def given(p):
        made = cell(p)
        if isinstance(made, Lattice):
            *made, found = repeated_in(made)
            origin.update(found)
        return chain_of(*made, speed)

    middle = given((low + high) / 2)
    if middle.mirror is None or len(middle.masses) == 1:
        refuse(
            "cell",
            "a cell of several sites, mirrored by a bead or a contact",
            "one that is not",
            "Where masses and stiffnesses both alternate, two parameters have to be right.",
        )
    if not middle.stiffness.any() and len(middle.masses) > 2:
        refuse(
            "cell",
            "two sites in a cell without a stiffness at rest",
            f"{len(middle.masses)}",
            "A wave then needs two parameters to be right; give a precompression.",
        )
    for p in (low, high):
        _faster_than_sound(given(p), speed)
    search = lambda: without_tail(given, low, high)
    return _recorded(search, None, speed, solved_for=True, **origin)


def _recorded(search, resonator, speed, solved_for=False, **fields):
    try:
        found = search()
        solved = found.solved
        box, phi, *_ = solved
        tail = found.tail
        top = _top(box, phi)
        size = np.nan if found.waves else 0.0
        if tail is not None:
            size = abs(tail.amplitude)
            if size > LOUDEST * solved.top:
                raise Lost("its ripple is as strong as the wave itself")
            if size < SILENT * top:
                size = 0.0
                tail = None
    except Lost as lost:
        raise RuntimeError(f"No wave of speed {speed:.6g} was found: {lost}.") from None
    chain = box.chain
    v = speed * box.velocities(phi)
    error = (error_of(found) + abs(fields.get("_off", 0.0))) * top
    if tail is not None:
        error += max(
            nearest(box.x, table, tail.wavenumber, found.core)[1] for table in (phi, v / speed)
        )
    return CellWave(
        speed,
        chain.given,
        top,
        size,
        wavenumber=tail and tail.wavenumber,
        linear_wavenumber=found.ripple and found.ripple.wavenumber,
        parameter=solved.parameter if solved_for else None,
        energy=np.nan if size or np.isnan(size) else _energy(box, phi, v, speed, resonator),
        residual=solved.residual,
        error=error,
        radiation=0.0 if not size else _radiation(chain, found.ripple, size, speed),
        xi=box.x,
        strains=phi,
        velocities=v,
        resonator=resonator,
        _core=found.core,
        _waves=found.waves,
        **fields,
    )


def _radiation(chain, ripple, size, speed):
    # Return (c - domega/dk) times the energy per site of a ripple of twice the amplitude.
    if np.isnan(size) or chain.resonator is not None or not chain.stiffness.any():
        return np.nan
    energy = np.mean(chain.stiffness * np.abs(2 * size * ripple.shape) ** 2) / 2
    return float(energy * speed * (1 - group(chain, ripple.wavenumber)))


def _top(box, phi):
    bond, at = np.unravel_index(np.argmax(np.abs(phi)), phi.shape)
    near = box.x[at]
    apart = box.x[1] - box.x[0]

    def size(x):
        return np.abs(fourier(phi[bond : bond + 1], box.half, x)[0])

    return highest(size, near - apart, near + apart)[1]


def _energy(box, phi, v, speed, resonator):
    chain = box.chain
    density = chain.given[:, None] * v**2 / 2 + chain.unit * chain.bonds(phi)[2]
    if resonator is not None:
        velocity, stretch = swinging(v, box.x, speed, resonator)
        density += float(resonator.mass) * velocity**2 / 2
        density += float(resonator.stiffness) * stretch**2 / 2
    return float(density.sum() * 2 * box.half / box.points / len(density))
