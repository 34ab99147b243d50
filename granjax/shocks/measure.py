"""`measure`: the numbers of a dispersive shock, from the lattice."""

from typing import NamedTuple

import jax
import numpy as np
from numpy.polynomial import Polynomial

from ..base.checks import one_of, refuse, whole
from ..base.types import Count
from ..flow import Run
from ..measures import peak_times
from ..profiles.highest import tops
from ..profiles.medium import values
from ..terms.chain import walls
from .given import medium_before, problem_of
from .riemann import Riemann
from .shock import Shock
from .theories import THEORIES, Seen, modulated
from .windows import BEYOND, LocalWave, local_wave, windows

# The least height of the leading crest, over the highest.
CREST = 0.3
# The unevenness of quiet bonds, over the range of strains.
QUIET = 1e-6
# The least number of waves in a shock.
WAVES = 3
# Other parts of the plateau, whose means are compared with that of one half of it.
SHARES = (0.3, 0.4, 0.6)
# The error of the plateau's mean over the largest difference from these means.
DOUBT = 5.0
# The number of quiet bonds in a row at the end; a window of the plateau has at least as many bonds.
EVEN = 8
# The part of the leading speed within which the plateau is first sought. Where its edge is slower,
# linear waves leave too few bonds for a mean over many of them.
NEAR = 0.05
# The part of the time by which the leading crest may differ from place over speed.
WANDER = 0.1
# The rounds in which plateau and edge are made consistent.
ROUNDS = 3
# The first window's place between the trailing edge, 0, and the leading crest, 1.
FROM = 0.15
# The last window's place there; one more window is at the leading crest itself.
TO = 0.92
# The least duration of a window in periods of the trailing waves.
PERIODS = 2.6
# The same in periods of the leading waves.
APART = 2.1
# The longest step of a window over the time of sound per bond, so that h omega_max = 1/2.
STEP = 0.25
# The least amplitude, over the leading one, of the waves that determine the trailing edge. Below,
# the plateau rings.
RINGS = 0.08
# The largest amplitude of these waves, over the leading one.
SMALL = 0.8


class Profile(NamedTuple):
    """The state of a shock to the right at a time; `places` count bonds from the step."""

    time: float
    places: np.ndarray
    strain: np.ndarray
    velocity: np.ndarray
    ahead: float
    # 1 for a shock of compression, -1 for one of rarefaction.
    sign: float

    @property
    def extreme(self):
        """The strain of the shock that is farthest from that ahead."""
        return float(self.sign * np.max(self.sign * self.strain[self.places > 0]))


def measure(
    run: Run,
    problem: Riemann | None = None,
    *,
    side: str = "right",
    theory: str = "toda",
    points: Count = 11,
) -> Shock:
    r"""Measure plateau, edges, amplitude and modulation of a dispersive shock after a run.

    From the last state, short windows of the chain, at the leading crest and at `points` places
    between the edges, are run on for some periods of their waves. Crests are then seen in time,
    where they are not lost between two bonds.

    **Arguments:**

    - `run`: of `problem.run(t1)`, or `gx.simulate(*problem, t1)`; the longer, the nearer to the
      theory's t -> infinity.
    - `problem`: what was run; `None`: the problem that the run remembers, or that its first state
      shows: a step in the strain or the velocity, or a moving wall. One chain of equal masses and
      bonds, without losses.
    - `side`: "right" or "left" of the step. `theory`: "toda" or "kdv", whose modulated waves are
      fitted.
    - `points`: W, the most windows: no two have the same middle.

    **Returns:** `Shock`, without derivatives. Typical: the plateau's mean is accurate to 1e-6 at
    t = 2000, m to 2e-3, the edges to 1/t.
    **Raises** ValueError for a run without a problem, waves that have reached the ends, a run
    without a shock (no crest above the plateau), a chain of several masses or laws, a batch.

    **Example:**

    >>> problem = gx.shocks.velocity_shock(gx.scenes.toda(200), 0.5)
    >>> shock = gx.shocks.measure(problem.run(step=0.1), points=3)
    >>> edges = gx.theory.toda.velocity_shock(0.5)
    >>> abs(shock.leading_speed - float(edges.leading_speed)) < 0.05
    True
    >>> round(float(edges.leading_speed), 5), round(float(edges.mean), 5)
    (1.31519, 0.81093)
    """
    one_of("side", side, ("right", "left"))
    one_of("theory", theory, tuple(THEORIES))
    points = whole("points", points, 3, "The trailing edge follows from the waves before it.")
    problem = problem_of(run, problem)
    medium = medium_before(problem)
    profile = _profile(run, problem, side)
    crest = _leading(profile)
    time = profile.time
    lead = float(profile.places[crest])
    plateau = _plateau(problem, profile, medium, lead / time)
    sound, behind, fastest = _speeds(medium, profile.ahead, plateau.mean, profile.extreme)
    trailing = _developed(sound, behind, lead, time, plateau.mean)
    span = _span(profile, crest, behind, trailing)
    middle = time + span / 2
    s = trailing + (lead / time - trailing) * np.linspace(FROM, TO, points)
    index = np.unique(
        np.rint(np.interp(s * middle, profile.places, np.arange(len(profile.places)))).astype(int)
    )
    points = len(index)
    index = np.append(index, crest)
    # Adaptive steps may have been too long for the solver of the windows.
    step = min(float(run.stats["step"]), STEP / max(sound, behind, fastest))
    cut = windows(
        medium, profile.strain, profile.velocity, index, span, max(fastest, lead / time), step
    )
    speed, speed_error, height, height_error = _crest_in_time(cut, profile, lead / time)
    xi, tau, strains = cut.near()
    waves = [local_wave(xi, tau, profile.sign * strains[..., j]) for j in range(points)]
    local = LocalWave(*map(np.array, zip(*waves)))
    places = profile.places[index[:-1]]
    local = local._replace(mean=profile.sign * local.mean)
    edge, edge_error = _edge(places / middle, local, height, middle)
    if not edge_error < speed - edge:
        edge = edge_error = np.nan
    seen = Seen(places, middle, xi, tau, strains[..., :-1], local)
    fit = modulated(theory, medium, profile.ahead, plateau.mean if plateau.wide else np.nan, seen)
    way = 1 if side == "right" else -1
    fit["speeds_of_m"] = way * fit["speeds_of_m"]
    return Shock(
        time=time,
        ahead=profile.ahead,
        sound=sound,
        mean=plateau.mean,
        mean_error=plateau.error,
        window=way * plateau.window,
        leading_speed=way * speed,
        leading_speed_error=speed_error,
        leading_place=way * lead,
        amplitude=height,
        amplitude_error=height_error,
        trailing_speed=way * edge,
        trailing_speed_error=edge_error,
        s=way * places / middle,
        means=local.mean,
        amplitudes=local.amplitude,
        wavelengths=2 * np.pi / local.wavenumber,
        omegas=local.omega,
        misfits=local.misfit,
        **fit,
        theory=theory,
        law=medium.law,
        mass=medium.mass,
        **medium.origin,
    )


def _developed(sound, behind, lead, time, mean):
    if not np.isfinite(behind) or not behind > 0:
        refuse(
            "run",
            "a plateau at which the law is stiff",
            f"a mean strain of {mean:g}, where it is not",
            "Contacts have opened behind, or the law ends there.",
        )
    if not behind > sound:
        refuse(
            "run",
            "a shock: faster sound behind than ahead",
            f"{behind:.12g} behind and {sound:.12g} ahead",
            "This is a rarefaction, or a linear chain: gx.theory.simple_wave and linear_shock.",
        )
    trailing = max(2 * sound - behind, 0.0)
    length = np.pi / np.arccos(min(trailing / behind, 1 - 1e-12))
    room = lead - trailing * time
    if not room > WAVES * length:
        refuse(
            "run",
            f"a shock of {WAVES} waves or more",
            f"one in which {max(room, 0) / length:.2g} have room",
            f"They are {length:.3g} bonds long, and the shock grows by about {behind - sound:.2g} bonds a unit of "
            "time, or twice that: run it longer.",
        )
    return trailing


def _profile(run, problem, side):
    strain = np.asarray(problem.strain(run.final.u), float)
    time = float(np.asarray(run.ts)[-1])
    velocity = np.asarray(run.final.v, float)
    places = np.arange(len(strain)) - float(problem.centre)
    if problem.kind == "piston":
        wall = next(term for term in problem.lattice.terms if walls(term) == ("left",))
        own = wall.compression(time, run.final.u)[0]
        speed = jax.jvp(wall.motion, (time,), (1.0,))[1]
        strain = np.append(own, strain)
        velocity = np.append(speed, velocity)
        places = np.append(places[0] - 1, places)
    if side == "left":
        strain = strain[::-1]
        velocity = -velocity[::-1]
        places = -places[::-1]
    first = np.asarray(problem.strain(problem.state.u), float)[-1 if side == "right" else 0]
    even = np.abs(strain - first) <= QUIET * np.ptp(strain)
    quiet = np.flatnonzero(
        (np.convolve(even, np.ones(EVEN), "valid") == EVEN) & (places[: 1 - EVEN] > 0)
    )
    if not np.ptp(strain) > 0 or not quiet.size or quiet[0] < 4 * EVEN:
        got = f"strains from {strain.min():g} to {strain.max():g} up to the {side} end, where {first:g} was"
        remedy = "Take a longer chain or a shorter run; problem.horizon() is the longest."
        if run.final.u.dtype == np.float32:
            # Where beads ahead move, strains are differences of large displacements.
            remedy = f"Rounding in float32 alone can disturb them: run it in float64. {remedy}"
        refuse("run", "a shock with quiet bonds before it", got, remedy)
    # Waves from an end that is held are cut off.
    last = quiet[-1] + EVEN
    behind = strain[(places > 0) & (places <= NEAR * places[quiet[0]] + EVEN)].mean()
    sign = float(np.sign(behind - first))
    return Profile(time, places[:last], strain[:last], velocity[: last + 1], float(first), sign)


def _leading(profile):
    x = profile.sign * (profile.strain - profile.ahead)
    top = tops(x)
    top = top[(x[top] > CREST * x[profile.places > 0].max()) & (profile.places[top] > 0)]
    if not top.size:
        refuse(
            "run",
            "a shock, whose leading crest is the first of many",
            "a front without a crest",
            "A rarefaction fan has none; a longer run has one where there is a shock.",
        )
    return int(top[-1])


class Plateau(NamedTuple):
    """The weighted mean of the strain over a window, and its difference from that of other windows.

    `wide`: whether linear waves leave it long enough for a mean over many of them.
    """

    mean: float
    error: float
    window: np.ndarray
    wide: bool


def _plateau(problem, profile, medium, lead):
    mean = _hann(profile, np.array([-1.0, 1.0]) * max(NEAR * lead * profile.time, EVEN))
    for _ in range(ROUNDS):
        sound, behind = _speeds(medium, profile.ahead, mean)
        wide = 2 * sound - behind > NEAR * lead
        own = 2 * sound - behind if wide else 2 * NEAR * lead
        # The plateau of a piston is taken with its mirror image.
        other = -behind if problem.kind == "strain" else -own
        ends = profile.time * np.array([other, own])
        inner, *others = ((ends.mean() + share * (ends - ends.mean())) for share in (0.5, *SHARES))
        if not np.ptp(inner) > EVEN:
            refuse(
                "run",
                f"a plateau of more than {2 * EVEN} bonds",
                f"one of {np.ptp(ends):.2g}",
                "Run it longer.",
            )
        mean = _hann(profile, inner)
    # The plateau rings slowly too, so the error takes several windows, and a factor from means that
    # are known exactly.
    error = DOUBT * max(abs(mean - _hann(profile, other)) for other in others) + 1e-15 * abs(mean)
    if not wide:
        # There may be waves that alternate from bond to bond.
        there = profile.strain[(profile.places > inner[0]) & (profile.places < inner[1])]
        error += float(np.std(there) / np.sqrt(len(there)))
    return Plateau(mean, error, inner, wide)


def _hann(profile, window):
    low, high = window
    x = (profile.places - low) / (high - low)
    weight = np.where((x > 0) & (x < 1), np.sin(np.pi * x) ** 2, 0.0)
    return float(weight @ profile.strain / weight.sum())


def _speeds(medium, *strains):
    return [
        float(x) for x in np.sqrt(values(medium.law, np.array(strains))[1] / float(medium.mass))
    ]


def _span(profile, crest, behind, trailing):
    # On the plateau omega = 2 V sin(k/2), with the group speed V cos(k/2).
    omega = 2 * behind * np.sqrt(max(1 - (trailing / behind) ** 2, 0.0))
    top = tops(profile.sign * profile.strain[:crest])
    gap = (crest - top[-1]) * profile.time / profile.places[crest] if top.size else 0.0
    return float(max(PERIODS * 2 * np.pi / omega, APART * gap))


def _crest_in_time(cut, profile, speed):
    x = profile.sign * (cut.strains[..., -1] - profile.ahead)
    ts = cut.times
    peaks = peak_times(ts, x[:, cut.half : -BEYOND])
    times = np.asarray(peaks.times)
    heights = np.asarray(peaks.heights)
    n = np.arange(len(times))
    # Later crests, and disturbances of the window's ends, come at other times.
    there = np.abs(times - n / speed) < 1 / speed + WANDER * ts[-1]
    n = n[there]
    t = times[there]
    h = heights[there]
    if len(n) < 3:
        refuse(
            "run", "a leading crest that passes some bonds", f"{len(n)} of them", "A longer run."
        )
    slope = lambda part: float(np.polyfit(t[part], n[part], 1)[0])
    whole = slope(slice(None))
    half = (len(n) + 1) // 2
    error = max(abs(slope(part) - whole) for part in (slice(half), slice(len(n) - half, None)))
    return whole, error, float(h.mean()), float(np.ptp(h))


def _edge(s, local, height, time):
    amplitudes = local.amplitude
    small = np.isfinite(amplitudes) & (amplitudes > RINGS * height) & (amplitudes < SMALL * height)
    if small.sum() < 4:
        return np.nan, np.nan
    at = lambda order, part: float(
        Polynomial.fit(amplitudes[small][part], s[small][part], order)(0.0)
    )
    edge = at(2, slice(None))
    if not edge > 0:
        return np.nan, np.nan
    others = [at(3, slice(None))] + [at(2, slice(1, None))] * int(small.sum() > 4)
    length = 2 * np.pi / local.wavenumber[small][0] / time
    return edge, max(abs(edge - other) for other in others) + length
