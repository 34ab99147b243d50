"""The reflection of a wave at the end of its chain: delay, amplitude and energy."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.arrays import trailing
from ..base.checks import refuse
from ..base.programs import shared_size
from ..base.types import Count, Numbers, Scalar
from ..flow import Run
from ..flow.steps import floored_frequency
from ..lattice import State
from ..laws import Law, taylor
from ..results import Result, array, note
from ..terms import Wall
from .solitary import Wave, a_wave
from .stability import free_chain
from .tracking import leaving, reach_of, run_twice, tracked

# The frames of a run.
FRAMES = 257
# The spare contacts of the chain.
BEYOND = 8
# h omega of a time step, with the bound on the frequencies as omega.
STEP = 0.2
# The strain, over the peak, at which a wave ends.
TAIL = 1e-14
# The least number of frames for a line.
LEAST = 6
# How often a run is tried, each time twice as long, until the slowest lane's wave is back.
AGAIN = 3
# The strain, over the peak, that does not count as a wave.
FAINT = 1e-3


class Reflection(Result):
    """The result of `reflect`: arrays over the lanes of the wall, or single numbers.

    They are NaN where no solitary wave came back, for the reason in `outcome`. The energy that the
    reflected wave has lost is in other waves.
    """

    delay: Numbers = array(
        "The delay of the leading reflected wave at the last bead, relative to an ideal mirror "
        "there; negative where it is early, as at a rigid end.",
        "s",
    )
    delay_error: Numbers = array(
        "The error of the delay, from either half of the frames and from twice the time step.", "s"
    )
    speeds: Numbers = array("The speed of the reflected wave.", "1/s")
    speed_errors: Numbers = array("The error of the speed.", "1/s")
    amplitudes: Numbers = array("The amplitude of the reflected wave.", "m")
    amplitude_errors: Numbers = array("The error of the amplitude.", "m")
    energies: Numbers = array("The energy of the reflected wave.", "J")
    energy_errors: Numbers = array("The error of the energy.", "J")
    misfits: Numbers = array(
        "The largest residual of the fit of the reflected wave, over its peak.", "1"
    )
    speed: float = note("The speed of the incident wave.", "1/s")
    amplitude: float = note("The amplitude of the incident wave.", "m")
    energy: float = note("The energy of the incident wave.", "J")
    distance: int = note(
        "The distance from the last bead, in contacts, at which the reflected wave was followed.",
        "1",
    )
    run: Run = note("The run.")
    # The reason of each lane without a result; the static forces of the wall and of the chain.
    _lost: tuple[str, ...] = eqx.field(static=True)
    _loads: tuple[float, float] = eqx.field(static=True)

    @property
    def outcome(self) -> str:
        """Whether a wave came back from every wall, or why not."""
        why = list(dict.fromkeys(filter(None, self._lost)))
        if not why:
            said = f"Came back; delays are known to {np.max(self.delay_error):.1e}."
        else:
            count = len(self._lost)
            some = f"{sum(map(bool, self._lost))} of {count} walls" if count > 1 else "this wall"
            said = (
                f"Of {some} nothing is known: {'; '.join(why)}. A larger distance lets waves part."
            )
        wall, chain = self._loads
        if abs(wall - chain) > 1e-9 * max(abs(wall), abs(chain)):
            said += (
                f" The wall's static force {wall:.4g} is not the chain's {chain:.4g}: a constant load on the "
                "last bead holds the difference."
            )
        return said


def reflect(
    wave: Wave,
    wall: Law | None = None,
    *,
    distance: Count | None = None,
    step: Scalar | None = None,
) -> Reflection:
    r"""Send a solitary wave against the wall at the end of its chain, and measure its reflection.

    The leading reflected wave is found, as in `collide`, by a least-squares fit of the exact wave
    of its speed, from `distance` to 1.5 `distance` contacts from the last bead. Its line of places,
    extrapolated back, leaves the last bead a `delay` after the line of the incident wave arrives
    there.

    **Arguments:**

    - `wave`: of `solitary_wave`, to the right (speed > 0). `wall`: any law of the contact between
      the last bead and the wall, from equilibrium; parameters of shape (B,) are lanes, all in one
      program. `None`: rigid, the last bead is held; this is the limit of an infinitely stiff
      contact.
    - `distance`: contacts, at least 30 with `None` and far enough that sound has fallen behind. The
      larger it is, the more of the other reflected waves has fallen behind.
    - `step`: time step; `None` is 1/5 over the bound on the frequencies of the stiffest lane.

    A bead of radius R on an elastic half-space of Young's modulus E (an array: lanes), in SI:

        R, E, F0 = 9.525e-3, 2e11, 20.0
        half_space = gx.materials.Material("wall", E, 0.3, 1.0)
        A = gx.materials.hertz_coefficient("steel 316", R, half_space, float("inf"))
        wall = gx.Hertz(A, F0)

    **Returns:** `Reflection`. The delay falls as the contact stiffens, towards the rigid limit:
    -ln(cosh k)/sinh k for Toda's soliton. Not differentiable: places are fitted.
    **Raises** ValueError for a wave to the left, traced numbers, and a wall with several axes of
    lanes.
    Source: J. Yang, C. Silvestro, D. Khatri, L. De Nardo, C. Daraio, Phys. Rev. E 83, 046606
    (2011); S. Job, F. Melo, A. Sokolow, S. Sen, Phys. Rev. Lett. 94, 178002 (2005).

    **Example:**

    >>> wave = gx.travelling.solitary_wave(gx.Toda(), speed=2.0)
    >>> round(float(gx.travelling.reflect(wave).delay), 6)
    -0.343757
    >>> k = gx.theory.toda.wavenumber(speed=2.0)
    >>> round(float(-jnp.log(jnp.cosh(k)) / jnp.sinh(k)), 6)  # what Toda's soliton does at a rigid wall
    -0.343757
    """
    a_wave("wave", wave)
    if not float(wave.speed) > 0:
        refuse("wave", "one to the right, where the wall is", f"speed {float(wave.speed):g}")
    speed = float(wave.speed)
    reach = reach_of(wave, TAIL)
    # Waves at the speed of sound must fall behind.
    sound = float(jnp.sqrt(jnp.maximum(taylor(wave.law).K2, 0.0) / wave.mass)) / speed
    distance = max(30, int(reach * max(2, 1 / (1 - sound)))) if distance is None else distance
    more = 0.25 * reach + 4
    sites = shared_size(int(np.ceil(max(1.5 * distance, reach + more) + reach)) + BEYOND)
    # Contact n lies at n + 1/2 in bead numbers. A held bead is the wall of a chain of one bead
    # less.
    mirror = sites - (0.5 if wall is None else 1.5)
    wall = wave.law if wall is None else wall
    lanes = jax.eval_shape(lambda: wall.force(jnp.zeros(()))).shape
    if len(lanes) > 1:
        refuse("wall", "one axis of lanes", f"lanes of shape {lanes}", "Flatten them.")
    lattice = _ended(wave, sites, wall, lanes)
    path = _Path(
        wave, mirror - reach - more, mirror, more / speed, (reach + more) / speed, distance
    )
    # The beads ahead of the wave are at rest in place, as the wall is.
    zeros = lattice.zeros()
    state = State(*(zeros + trailing(x, zeros.ndim) for x in wave.state(sites, path.start)))
    time = path.arrival + 1.25 * (1.5 * distance + reach) / speed
    for _ in range(AGAIN):
        own = STEP / float(floored_frequency(lattice, state, 0.0, time)) if step is None else step
        runs = run_twice(lattice, state, time, FRAMES, own)
        found, lost = zip(*(_returned(path, runs, lane) for lane in np.ndindex(lanes)))
        if LATE not in lost:
            break
        time = 2 * time
    return Reflection(
        *map(np.asarray, np.transpose(found).reshape(-1, *lanes)),
        speed=speed,
        amplitude=float(wave.amplitude),
        energy=float(wave.energy),
        distance=distance,
        run=runs[0],
        _lost=lost,
        _loads=tuple(float(np.max(law.preload)) for law in (wall, wave.law)),
        _mark=runs[0]._mark,
    )


LATE = "no wave has come back yet"


class _Path(NamedTuple):
    """The wave and its contact at time 0; the wall's place; when to follow both waves, and where."""

    wave: Wave
    start: float
    mirror: float
    before: float
    arrival: float
    distance: int


def _ended(wave, sites, wall, lanes):
    made = lambda wall: free_chain(wave, sites, Wall(wall, "right"))
    if lanes:
        over = jax.tree.map(lambda x: 0 if eqx.is_array(x) and x.shape == lanes else None, wall)
        made = jax.vmap(made, in_axes=(over,), out_axes=-1)
    return made(wall)


def _returned(path, runs, lane):
    wave = path.wave
    none = [np.nan] * 9
    ts = np.asarray(runs[0].ts, float)
    seen = ts, *(-np.diff(np.asarray(run.us, float)[(..., *lane)], axis=1) for run in runs)
    first = ts <= path.before
    guesses = path.start + float(wave.speed) * ts[first]
    sent = tracked(wave, *(x[first] for x in seen), guesses)
    frames, guesses = _leading(path, ts, np.sign(float(wave.amplitude)) * seen[1])
    if len(frames) < LEAST or frames[-1] + 1 == len(ts):
        return none, LATE
    found = leaving(wave, *(x[frames] for x in seen), guesses)
    if found.why:
        return none, f"what comes back {found.why}"
    back = found.track
    came, early = sent.passes(path.mirror)
    left, late = back.passes(path.mirror)
    delay = (left - came, early + late)
    speed = (-back.speed, back.speed_error)
    return [*delay, *speed, *found.amplitude, *found.energy, back.misfit], ""


def _leading(path, ts, strains):
    near = path.mirror - path.distance
    far = path.mirror - 1.5 * path.distance
    seen = strains[:, : int(near + path.distance / 2)]
    places = np.argmax(seen, axis=1)
    there = seen.max(1) > FAINT * abs(float(path.wave.amplitude))
    within = there & (ts > path.arrival) & (places <= near) & (places >= far)
    first = int(np.argmax(within))
    count = int(np.argmin(np.append(within[first:], False)))
    frames = np.arange(first, first + count)
    return frames, places[frames]
