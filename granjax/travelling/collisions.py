"""Collisions of two waves: phase shifts, speeds and energies afterwards."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse, within
from ..base.programs import shared_size
from ..base.types import Number, Numbers, Parameter, Scalar
from ..flow import Run
from ..lattice import State
from ..profiles.medium import values
from ..results import Result, array, note
from .solitary import Wave, a_wave
from .stability import free_chain
from .tracking import leaving, reach_of, run_twice, tracked

# The frames before the collision, and in as much time after it.
FRAMES = 64
# The time before the collision in which the waves are followed, over the rest until they meet.
MORE = 0.25
# The spare contacts at either end.
BEYOND = 8
# h omega of the first time step, for the highest frequency omega.
STEP = 0.2
# The number of strains at which the speed of sound is computed.
STRAINS = 65
# The times after the collision, over that before it, until the waves are free of their radiation.
LONGER = 1, 4, 16
# The error over the distance to the line through the frames before. Effects of radiation may fall
# like 1/t; their limit is then 3.5 times as far from the last line as that is from the one before.
LEFT = 4
# The part of the least separation at which waves have parted.
APART = 0.8
# The strain, over peak and tolerance, at which a wave ends.
TAIL = 1e-6
# The lower bound of that strain, over the peak.
ROUNDING = 1e-15
# The relative difference up to which speeds, laws and times are equal.
SAME = 1e-12


class Collision(Result):
    """The result of `collide`; the first of two numbers is of the first wave.

    With several phases, these are the last axis of all arrays and numbers that depend on the phase.
    """

    kind: str = array('"overtaking" or "head-on".')
    meeting: float = note("The time at which the waves would have met as points.", "s")
    phase: Number = array("The part of `meeting_place` beyond a contact, as given.", "1")
    meeting_place: Number = array("The place where the waves would have met, in contacts.", "1")
    shifts: Numbers = array(
        "The distance along n of each wave from where it would be alone, at `meeting`, by "
        "straight lines through its places before and after; NaN where the waves have not "
        "parted.",
        "1",
        "wave",
    )
    shift_errors: Numbers = array(
        "The error of the shifts, from either half of the frames, from as many earlier frames, "
        "and from twice the time step.",
        "1",
        "wave",
    )
    speeds: Numbers = array("The speeds before.", "1/s", "wave")
    speeds_after: Numbers = array("The speeds after.", "1/s", "wave")
    speed_errors: Numbers = array("The errors of the speeds.", "1/s", "wave")
    amplitudes: Numbers = array("The amplitudes before.", "m", "wave")
    amplitudes_after: Numbers = array("The amplitudes after.", "m", "wave")
    amplitude_errors: Numbers = array("The errors of the amplitudes.", "m", "wave")
    energy: float = note("The energy of both waves before.", "J")
    radiated: Number = array("The energy that neither wave has afterwards.", "J")
    radiated_error: Number = array("The error of the radiated energy.", "J")
    separation: Number = array(
        "The least distance between the two waves in the frames after the collision, in contacts.",
        "1",
    )
    least_separation: float = note(
        "The separation at which the waves have parted, in contacts.", "1"
    )
    misfits: Numbers = array(
        "The largest residuals of the fits of the waves, over their peaks.", "1", "wave"
    )
    times: Numbers = array("The times of the frames.", "s", "found")
    places: Numbers = array("The place of each wave in each frame.", "1", "wave found")
    run: Run = note("The run.")
    # The reason of each phase without shifts.
    _lost: tuple[str, ...] = eqx.field(static=True)

    @property
    def outcome(self) -> str:
        """Whether the waves have parted, and the accuracy of their shifts."""
        shifts, errors = (np.reshape(x, (2, -1)) for x in (self.shifts, self.shift_errors))
        parted = ~np.isnan(shifts[0])
        said = []
        if len(parted) > 1:
            said.append(f"At {parted.sum()} of {len(parted)} phases they have parted.")
        if parted.any():
            ends = [(f"{x.min():.6g}", f"{x.max():.6g}") for x in shifts[:, parted]]
            ranges = (low if low == high else f"{low} ... {high}" for low, high in ends)
            error = errors[:, parted].max()
            said.append(f"They are shifted by {' and by '.join(ranges)} contacts, to {error:.1e}.")
        if not parted.all():
            said.append(f"No shift: {next(filter(None, self._lost))}.")
        return " ".join(said)


def collide(
    first: Wave,
    second: Wave,
    *,
    phase: Parameter = 0.0,
    tolerance: Scalar = 1e-7,
    step: Scalar | None = None,
) -> Collision:
    r"""Let two solitary waves of a chain collide; measure phase shifts, speeds and energies.

    Both start on a chain with free ends, so far apart that neither tail reaches the other. They run
    until they are as far apart again, and longer where they are not yet free of radiation. Before
    and after, each is found by a least-squares fit of the exact wave of its speed. A shift is the
    distance of the two lines of places at the time when the waves would meet as points. In a chain
    that is not integrable the speeds change, so the shift depends on that time, by speeds_after -
    speeds. It also depends on where between two contacts the waves meet, the `phase`.

    **Arguments:**

    - `first`, `second`: of `solitary_wave`, of one law and mass, with different speeds. They
      overtake where both run one way, and meet head-on where one speed is negative.
    - `phase`: the place beyond a contact where their peaks would meet as points, x_1 + c_1 t =
      x_2 + c_2 t, in contacts, modulo 1: 0 on a contact, 1/2 on a bead. Several, (P,), are lanes of
      one run: np.linspace(0, 1, 8, endpoint=False) gives the range.
    - `tolerance` in (0, 0.1): of the shifts [contacts]. A tail ends at `tolerance`/10^6 of the
      peak. Where an error is larger, the waves are followed four, then sixteen times as long, with
      half the step each time. Time and sites grow with the length of the tail over the difference
      in speed.
    - `step`: the first time step; `None` is 1/5 over the highest frequency of the chain at strains
      of both waves together.

    **Returns:** `Collision`. Not differentiable: places are fitted. Toda's k = 1 and 0.5: shifts
    +1.180269670641735, -2.360539341283469 overtaking, +0.2273362938026457, -0.4546725876052915
    head-on.
    **Raises** ValueError for waves of different chains, equal speeds, and traced numbers.
    Source: N. J. Zabusky, M. D. Kruskal, Phys. Rev. Lett. 15, 240 (1965); Y. Shen, P. G.
    Kevrekidis, S. Sen, A. Hoffman, Phys. Rev. E 90, 022905 (2014).

    **Example:**

    >>> fast, slow = (gx.travelling.solitary_wave(gx.Toda(), speed=c) for c in (2.0, -1.8))
    >>> found = gx.travelling.collide(fast, slow, tolerance=1e-2)
    >>> print(found.shifts.round(4))
    [ 0.6427 -0.7046]
    >>> k1, k2 = (gx.theory.toda.wavenumber(speed=c) for c in (2.0, 1.8))
    >>> [round(float(shift), 4) for shift in gx.theory.toda.phase_shifts(k1, k2, head_on=True)]
    [0.6427, -0.7046]
    """
    waves = first, second
    tolerance = float(within("tolerance", tolerance, 0, 0.1, open_low=True, open_high=True))
    _of_one_chain(*waves)
    phases = np.asarray(phase, float)
    parted = max(reach_of(wave, max(TAIL * tolerance, ROUNDING)) for wave in waves)
    speeds = np.array([float(wave.speed) for wave in waves])
    meeting = (1 + MORE) * parted / abs(speeds[0] - speeds[1])
    step = STEP / (2 * _sound(waves)) if step is None else step
    margin = parted + BEYOND
    for longer in LONGER:
        ends = np.concatenate([-speeds, longer * speeds]) * meeting
        sites = shared_size(int(np.ceil(np.ptp(ends) + 2 * margin)) + 4)
        # The lines x + c t of the waves without interaction cross at `meeting`.
        starts = np.ceil(margin - ends.min()) + np.ravel(phases) % 1 - speeds[:, None] * meeting
        # Frames after the collision are as dense as before.
        runs = run_twice(
            *_begun(waves, sites, starts, phases.shape),
            (1 + longer) * meeting,
            FRAMES * (1 + longer) + 1,
            step / longer**0.5,
        )
        both = [-np.diff(np.reshape(run.us, (*run.us.shape[:2], -1)), axis=1) for run in runs]
        ts = np.asarray(runs[0].ts, float)
        found, lost = zip(
            *(
                _measured(waves, start, meeting, parted, ts, [x[..., k] for x in both])
                for k, start in enumerate(starts.T)
            )
        )
        if all(one["shift_errors"].max() <= tolerance for one in found):
            break
    # Several phases are the last axis.
    numbers = {name: np.stack([one[name] for one in found], -1) for name in found[0]}
    numbers["phase"] = np.ravel(phases) % 1
    return Collision(
        **{name: x if phases.ndim else x[..., 0] for name, x in numbers.items()},
        kind="overtaking" if speeds.prod() > 0 else "head-on",
        meeting=meeting,
        energy=float(first.energy + second.energy),
        least_separation=parted,
        run=runs[0],
        _lost=lost,
        _mark=runs[0]._mark,
    )


def _begun(waves, sites, starts, lanes):
    lattice = free_chain(waves[0], sites)
    if lanes:
        lattice = jax.vmap(lambda _: lattice, out_axes=-1)(np.zeros(lanes))
    parts = [[wave.state(sites, x) for wave, x in zip(waves, start)] for start in starts.T]
    shape = (-1, *lanes)
    return lattice, State(
        *(jnp.stack([sum(y[i] for y in pair) for pair in parts], -1).reshape(shape) for i in (0, 1))
    )


def _of_one_chain(first, second):
    for name, wave in (("first", first), ("second", second)):
        a_wave(name, wave)
    media = [(wave.law, wave.mass) for wave in (first, second)]
    if not eqx.tree_equal(*media, rtol=SAME, typematch=False) or first.units != second.units:
        refuse(
            "second",
            "a wave of the same law, mass and units as the first",
            "another chain",
            "Both are of solitary_wave(law, ...) with one law.",
        )
    one = float(first.speed)
    two = float(second.speed)
    if abs(one - two) <= SAME * abs(one):
        refuse(
            "second",
            "a speed other than the first's",
            f"{two:g} of both",
            "Two waves of one speed never meet; for one to the left take speed=-c.",
        )


def _sound(waves):
    # Return the largest speed of sound at any strain that both waves together can have.
    peaks = np.array([float(wave.amplitude) for wave in waves])
    strains = np.linspace(np.minimum(peaks, 0).sum(), np.maximum(peaks, 0).sum(), STRAINS)
    return float(np.sqrt(np.max(values(waves[0].law, strains)[1]) / float(waves[0].mass)))


def _measured(waves, start, meeting, parted, ts, both):
    of = lambda name: np.array([float(getattr(w, name)) for w in waves])
    speeds = of("speed")
    share = MORE / (1 + MORE)
    rest = ts[-1] - meeting
    seen = ts, *both
    early = ts <= share * meeting * (1 + SAME)
    late = ts >= ts[-1] - share * rest * (1 + SAME)
    # as many frames before them
    sooner = np.roll(late, -np.count_nonzero(late))
    free = start[:, None] + speeds[:, None] * ts

    def followed(method, wave, place, frames):
        first = _highest(wave, both[0][frames], place[frames], parted)
        return method(wave, *(x[frames] for x in seen), first)

    before = [tracked(w, *(x[early] for x in seen), place[early]) for w, place in zip(waves, free)]
    left = [followed(leaving, w, place, late) for w, place in zip(waves, free)]
    after = [one.track for one in left]
    lines = np.array([[track.at(meeting) for track in tracks] for tracks in (before, after)])
    shifts = lines[1, :, 0] - lines[0, :, 0]
    errors = lines[..., 1].sum(0)
    for k, track in enumerate(after):
        line = followed(tracked, track.wave, free[k], sooner).at(meeting)[0]
        errors[k] += LEFT * abs(line - lines[1, k, 0])
    amplitudes, energies = (
        np.array([getattr(x, n) for x in left]) for n in ("amplitude", "energy")
    )
    separation = np.min(np.abs(after[0].places - after[1].places))
    why = next((f"what leaves {one.why}" for one in left if one.why), "")
    if not separation > APART * parted:
        why = why or (
            f"the waves have not parted, {separation:.4g} contacts are between them and {parted:.4g} would be needed"
        )
    if why:
        shifts, errors, amplitudes, energies = (
            np.full_like(x, np.nan) for x in (shifts, errors, amplitudes, energies)
        )
    return dict(
        meeting_place=start[0] + speeds[0] * meeting,
        shifts=shifts,
        shift_errors=errors,
        speeds=speeds,
        speeds_after=np.array([track.speed for track in after]),
        speed_errors=np.array([track.speed_error for track in after]),
        amplitudes=of("amplitude"),
        amplitudes_after=amplitudes[:, 0],
        amplitude_errors=amplitudes[:, 1],
        radiated=of("energy").sum() - energies[:, 0].sum(),
        radiated_error=energies[:, 1].sum(),
        separation=separation,
        misfits=np.array([track.misfit for track in after]),
        times=np.concatenate([ts[early], ts[late]]),
        places=np.stack([np.concatenate([b.places, a.places]) for b, a in zip(before, after)]),
    ), why


def _highest(wave, strains, free, parted):
    near = np.abs(np.arange(strains.shape[1]) - free[:, None]) < parted / 2
    return np.argmax(np.where(near, np.sign(float(wave.amplitude)) * strains, -np.inf), 1)
