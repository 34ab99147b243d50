"""Sound bullets: pulses of several channels, delayed so that they meet at one site."""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import concrete, parameter, positive, refuse, traced, whole
from ..flow import simulate
from ..flow.record.kinds import Peak, PeakTime
from ..lattice import Lattice
from ..results import Held, Result
from ..states import rest
from ..terms import Term
from ..terms.base import Excitation
from ..terms.tracing import Dependence
from ..types import AnyArray, Cell, Count, Parameter, Scalar

# a crest in this last share of a run may be one that still rises, one below this share of what a push gives is none
EDGE, FAINT = 1e-3, 1e-6
# of the gain: an error above which no number is told to be one
ROUGH = 0.1
UNRESOLVED = " Its error is large: pulses so strong open contacts, and which crest is the highest is chance."


class SoundBullet(Result):
    """What `sound_bullet` returns. Velocities are those at the focus, along the direction, at their crest.

    - `alone` (N,) [m/s]: of each channel alone; `arrival` (N,) [s]: when; `delay` (N,) [s]: by which it is fired later,
      so that all arrive together.
    - `together` (N,) [m/s]: of the first 1, 2, ... N channels with their delays; `at_once`: of all without delays.
    - `gain` (N,): `together` over the largest of those `alone`. `bound` (N,): what the gain is where pulses add up,
      as they do in a linear lattice.
    - `alone_error`, `arrival_error`, `together_error`, `gain_error` (N,), `at_once_error`: distances from the truth.

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> found = gx.studies.sound_bullet(chain, [2, 14], 9, t1=20.0, force=0.01, duration=3.0, step=0.05)
    >>> found.together.shape, round(float(found.bound[0]), 2)
    ((2,), 0.93)
    """

    held: ClassVar[dict[str, Held]] = {
        "alone": Held("channel", "m/s"), "alone_error": Held("channel", "m/s"), "arrival": Held("channel", "s"),
        "arrival_error": Held("channel", "s"), "delay": Held("channel", "s"), "together": Held("channel", "m/s"),
        "together_error": Held("channel", "m/s"), "at_once": Held(unit="m/s"), "at_once_error": Held(unit="m/s"),
        "gain": Held("channel", "1"), "gain_error": Held("channel", "1"), "bound": Held("channel", "1"),
    }
    alone: Float[np.ndarray, " N"]
    alone_error: Float[np.ndarray, " N"]
    arrival: Float[np.ndarray, " N"]
    arrival_error: Float[np.ndarray, " N"]
    delay: Float[np.ndarray, " N"]
    together: Float[np.ndarray, " N"]
    together_error: Float[np.ndarray, " N"]
    at_once: float
    at_once_error: float

    @property
    def gain(self) -> Float[np.ndarray, " N"]:
        """What the first 1, 2, ... N channels give over what the strongest gives alone, (N,)."""
        return self.together / self.alone.max()

    @property
    def gain_error(self) -> Float[np.ndarray, " N"]:
        """Its distance from the truth, (N,)."""
        strongest = int(np.argmax(self.alone))
        return (self.together_error + self.gain * self.alone_error[strongest]) / self.alone[strongest]

    @property
    def bound(self) -> Float[np.ndarray, " N"]:
        """The gain where pulses add up, (N,)."""
        return np.cumsum(self.alone) / self.alone.max()

    @property
    def outcome(self) -> str:
        """The gain of all channels, beside what they could add up to and what they give without delays."""
        strongest = self.alone.max()
        return (f"{len(self.alone)} channels give {self.gain[-1]:.4g} +- {self.gain_error[-1]:.1g} times what one "
                f"gives; their sum would be {self.bound[-1]:.4g}, and without delays {self.at_once / strongest:.4g}."
                + (UNRESOLVED if np.any(self.gain_error > ROUGH * self.gain) else ""))


class _Pulses(Term):
    """Forces w F sin^2(pi (t - start)/T) on several sites, each for a time T from its start on."""

    dimensions = {"peak": (1, 0, 0), "duration": (0, 0, 1), "start": (0, 0, 1), "weight": (0, 0, 0)}
    peak: AnyArray
    duration: AnyArray
    start: AnyArray
    weight: AnyArray
    sites: tuple = eqx.field(static=True)
    direction: tuple | None = eqx.field(static=True)

    def dependence(self, lattice):
        return Dependence(time=True)

    def force(self, t, u, v, mass):
        phase = jnp.clip((t - self.start) / self.duration, 0, 1)
        f = self.weight * self.peak * jnp.sin(jnp.pi * phase) ** 2
        if self.direction is not None:
            f = jnp.stack([x * f for x in self.direction], 1)
        return jnp.zeros_like(u).at[self.sites].add(f)

    def excitation(self, lattice, ts):
        zero = jnp.zeros((), lattice.dtype)
        return Excitation(jnp.abs(self.peak), zero, zero)

    def span(self):
        return ()


class _AtFocus(NamedTuple):
    """The velocity of a site along a direction; equal ones compile once."""

    site: tuple
    direction: tuple | None

    def __call__(self, t, y, lattice):
        v = y.v[self.site]
        return v if self.direction is None else jnp.tensordot(jnp.asarray(self.direction, v.dtype), v, 1)


def sound_bullet(
    lattice: Lattice, channels: Parameter, focus: Count | Cell, t1: Scalar, *, force: Scalar, duration: Scalar,
    direction: Parameter | None = None, step: Scalar | None = None, progress: bool = False,
) -> SoundBullet:
    r"""A sound bullet: how high channels drive one site, if each is fired so much later that all pulses meet there.

    Each channel is a site that is pushed once, F sin^2(pi t/T) for 0 < t < T. First every channel alone: its crest at
    the focus comes at its arrival; the one that comes last is fired at once, the others later by what they are early.
    Then the first 1, 2, ... N together. In a linear lattice the pulses add up, in others they meet what others have
    moved.

    **Arguments:**

    - `lattice`: one lattice at rest, of one field, any laws: a packing, a square of springs, a graph of chains.
    - `channels`: sites that are pushed, (N,), or (N, 2) on a grid; `focus`: the site where they meet.
    - `t1`: how long each is watched from its push on [s]; reflections that come earlier than the pulse count too.
    - `force`: F [N]; `duration`: T [s], two or three times the time that sound takes from site to site.
    - `direction`: of the pushes and of the velocity at the focus, a vector of as many numbers as a site has components;
      `None` for displacements that are numbers.
    - `step`: as in `gx.simulate`. `progress`: a progress bar.

    **Returns:** `SoundBullet`; its picture is `gx.plots.sound_bullet`. It does not differentiate: crests are chosen.
    `gx.design` finds precompressions that delay the pulses of chains instead. **Raises** ValueError for sites that are
    not there, a batch, a missing direction; RuntimeError for a channel whose pulse does not arrive before t1.
    Source: Spadoni, Daraio, Proc. Natl. Acad. Sci. USA 107, 7230 (2010); Donahue, Anzel, Bonanomi, Keller, Daraio,
    Appl. Phys. Lett. 104, 014103 (2014).

    **Example:**

    >>> chain = gx.scenes.monomer(20, precompression=1.0)
    >>> found = gx.studies.sound_bullet(chain, [2, 14], 9, t1=20.0, force=0.01, duration=3.0, step=0.05)
    >>> print(found.gain.round(2))  # two pulses that meet
    [0.93 1.93]
    """
    if lattice.lanes or lattice.fields:
        refuse("lattice", "one lattice of one field", f"lanes {lattice.lanes}, fields {lattice.fields}")
    if traced((lattice, force, duration)):
        refuse("lattice", "a lattice that is known", "a traced one", "Which crest is the highest has no derivative.")
    sites, at = _sites(lattice, channels), _site("focus", focus, lattice.sites)
    along = _direction(lattice, direction)
    peak, duration, t1 = positive("force", force), positive("duration", duration), float(positive("t1", t1))
    record = {"height": Peak(_AtFocus(at, along)), "when": PeakTime(_AtFocus(at, along))}
    n = sites[0].size

    def crests(start, weight, end):
        """Heights and their errors, times and theirs, (lanes,) each, for what begins when, (lanes, N)."""
        def pulsed(start, weight):
            pulses = _Pulses(jnp.asarray(peak), jnp.asarray(duration), start, weight,
                             tuple(tuple(x.tolist()) for x in sites), along)
            return eqx.tree_at(lambda c: c.terms, lattice, (*lattice.terms, pulses))

        batch = jax.vmap(pulsed, out_axes=-1)(jnp.asarray(start), jnp.asarray(weight))
        run = simulate(batch, rest(batch), end, record=record, step=step, progress=progress)
        return [np.asarray(x[name]) for name in record for x in (run.recorded, run.record_error)]

    at_once = np.zeros((n + 1, n))
    alone, alone_error, arrival, arrival_error = crests(at_once, np.vstack([np.eye(n), np.ones(n)]), t1)
    own = jnp.broadcast_to(lattice.mass, lattice.zeros().shape)[at]
    least = FAINT * float(peak) * float(duration) / float(np.min(own))
    late = np.flatnonzero((alone[:n] < least) | (arrival[:n] > (1 - EDGE) * t1))
    if late.size:
        raise RuntimeError(f"The pulse of channel {late[0]} has no crest at the focus before t1 = {t1:g}. Watch "
                           "longer, or push along the direction in which it arrives.")
    delay = arrival[:n].max() - arrival[:n]
    together = np.vstack([np.tril(np.ones((n, n))), np.ones(n)])
    height, height_error, *_ = crests(np.tile(delay, (n + 1, 1)), together, t1 + float(delay.max()))
    return SoundBullet(
        alone[:n], alone_error[:n], arrival[:n], arrival_error[:n], delay, height[:n], height_error[:n],
        float(alone[n]), float(alone_error[n]), **lattice.origin)


def _site(name, given, sizes):
    index = tuple(given) if isinstance(given, (tuple, list)) else (given,)
    if len(index) != len(sizes) or any(not -n <= i < n for i, n in zip(index, sizes)):
        refuse(name, f"a site of {sizes}", repr(given))
    return tuple(whole(name, i % n, 0) for i, n in zip(index, sizes))


def _sites(lattice, channels):
    """Indices along each axis, (N,) each."""
    x = concrete(parameter("channels", channels))
    x = np.asarray(x)
    x = x[:, None] if x.ndim == 1 and lattice.axes == 1 else x
    if x.ndim != 2 or x.shape[1] != lattice.axes or not len(x) or np.any(x != np.round(x)):
        refuse("channels", f"whole numbers of shape (N, {lattice.axes}), a site each", f"shape {np.shape(channels)}")
    found = [_site(f"channels[{i}]", tuple(int(j) for j in row), lattice.sites) for i, row in enumerate(x)]
    if len(set(found)) < len(found):
        refuse("channels", "sites that differ", "one twice")
    return tuple(np.array(axis) for axis in zip(*found))


def _direction(lattice, given: Any):
    if lattice.dimension is None:
        if given is not None:
            refuse("direction", "None, as displacements are numbers", repr(given))
        return None
    if given is None:
        refuse("direction", f"a vector of {lattice.dimension} numbers", "None", "Along it channels push.")
    d = np.asarray(concrete(parameter("direction", given)), float)
    if d.shape != (lattice.dimension,) or not np.any(d):
        refuse("direction", f"a vector of {lattice.dimension} numbers, not zero", repr(given))
    return tuple((d / np.linalg.norm(d)).tolist())
