"""Periodic waves, by Newton's method on the Fourier form in a box of one wavelength."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import refuse, traced
from ..base.types import Number, Numbers
from ..continuation.newton import newton as root
from ..laws import Law, Strained
from .fourier import Box, Chain, fourier, newton, newton_with
from .medium import in_float64, values

# The numbers of points on half a wavelength, one after the other.
POINTS = (32, 64, 128, 256, 512)
# The difference, over the largest strain, at which two of these resolutions agree.
AGREE = 1e-13
# The rounding error of a Fourier sum, over the largest strain.
ROUNDING = 32 * np.finfo(float).eps
# The residual of Newton's method below which a wave is found.
CONVERGED = 1e-9
# The most steps of Newton's method.
STEPS = 30
# The residual that suffices to continue to the next amplitude.
FOLLOWED = 1e-6
# The growth of the amplitude from one wave to the next.
GROWTH = 1.5
# The most waves that are followed.
MOST = 60
# The first amplitude, over the strain scale of the law.
FIRST = 1e-2
# The longest wave of this amplitude that is nearly a cosine, in contacts. How near depends on the
# amplitude times the square of the length (Ursell's number).
COSINE = 20.0


class Train(NamedTuple):
    """A periodic wave: speed, tables (N,) over its box, mean strain, residual and error.

    `strain` is less the mean; `displacement` omits the mean compression of each bead.
    """

    speed: Number
    half: Number
    strain: Numbers
    velocity: Numbers
    displacement: Numbers
    mean: Number
    residual: float
    error: float

    def at(self, name: str, xi: Any) -> Numbers:
        """Return the strain, the velocity or the displacement at any places."""
        table = getattr(self, name)
        if traced((xi, tuple(self))):
            x = jnp.asarray(xi, float)
            hat = jnp.fft.rfft(table) / len(table)
            # All harmonics but the mean and the shortest count twice, with their conjugates.
            hat = hat.at[1:-1].multiply(2)
            angle = (x[..., None] + self.half) * np.pi / self.half * np.arange(len(hat))
            own = jnp.cos(angle) @ hat.real - jnp.sin(angle) @ hat.imag
        else:
            x = np.asarray(xi, float)
            own = fourier(table[None], self.half, x.ravel())[0].reshape(x.shape)
        more = {"strain": self.mean, "velocity": 0.0, "displacement": -self.mean * x}[name]
        # NumPy's sum of two scalars is not an array.
        return own + more if traced((own, more)) else np.asarray(own + more)


def differentiated(
    known: Train,
    law: Law,
    mass: Number,
    mean: Number,
    wavelength: Number,
    speed: Number | None,
    amplitude: Number | None,
) -> Train:
    """Return a known wave with its derivatives by the implicit function theorem."""
    j, cos, sin = _harmonics(len(known.strain) // 2)
    level = float(jax.lax.stop_gradient(mass)) * known.speed**2
    start = np.append(2 / cos.shape[1] * cos @ known.strain, level)
    given = law, mass, mean, wavelength, speed, amplitude
    x = root(_left, start, given, tolerance=FOLLOWED).x
    c = x[:-1]
    speed = jnp.sqrt(x[-1] / mass)
    half = np.pi * j / wavelength
    # A bead is half a contact behind its contact.
    own = c / (2 * jnp.sin(half))
    ahead = own * jnp.cos(half)
    behind = own * jnp.sin(half)
    velocity = speed * ((2 * half * ahead) @ cos + (2 * half * behind) @ sin)
    displacement = behind @ cos - ahead @ sin
    return Train(speed, wavelength / 2, c @ cos, velocity, displacement, mean, *known[-2:])


def _harmonics(count):
    # Return j < `count`, and cos, sin of j theta on a box, which begins at a trough.
    j = np.arange(1, count)
    theta = np.pi * np.arange(2 * count) / count - np.pi
    return j, np.cos(np.outer(j, theta)), np.sin(np.outer(j, theta))


def _left(x, given):
    law, mass, mean, wavelength, speed, amplitude = given
    j, cos, _ = _harmonics(len(x))
    c = x[:-1]
    level = x[-1]
    half = np.pi * j / wavelength
    force = 2 / cos.shape[1] * (cos @ law.force(mean + c @ cos))
    held = level - mass * speed**2 if amplitude is None else (j % 2) @ c - amplitude
    return jnp.append(level * c - (jnp.sin(half) / half) ** 2 * force, held)


class _Family(NamedTuple):
    """Waves of one length about one mean strain; `small`: m c^2 of the small ones."""

    law: Law
    mean: float
    wavelength: float
    stiffness: float
    small: float

    def box(self, points):
        laws = (Strained(self.law, jnp.asarray(self.mean)),)
        one = np.ones(1)
        chain = Chain(laws, one, one, 1.0, np.array([self.stiffness]), None, 0)
        return Box(chain, self.wavelength / 2, 2 * points, at_rest=False)

    def solved(self, box, phi, level, amplitude):
        if amplitude is None:
            return newton(box.of_level(level), phi, 1e-15, STEPS), level
        crest = np.zeros(box.points)
        crest[[0, box.points // 2]] = -0.5, 0.5
        found = newton_with(
            box.of_level, lambda _: crest, phi, level, level / 2, amplitude, 1e-15, STEPS
        )
        return found, found.parameter

    def grown(self, box, amplitude, before):
        phi, level, size = before
        found, level = self.solved(box, phi * (amplitude / size), level, amplitude)
        return (found.phi, level, amplitude) if found.residual < FOLLOWED else None

    def growing(self, box, first, most):
        wave = np.cos(2 * np.pi * box.x / self.wavelength)[None], self.small, 1.0
        now = first
        for _ in range(MOST):
            wave = self.grown(box, min(now, most), wave)
            if wave is None:
                return
            yield wave
            if wave[2] == most:
                return
            now *= GROWTH


def train(
    law: Law,
    mass: float,
    mean: float,
    wavelength: float,
    speed: float | None,
    amplitude: float | None,
) -> Train:
    """Find the wave of a speed or an amplitude about a mean strain, by following small waves.

    **Raises** ValueError without stiffness at the mean, or where the family does not reach the
    number.
    """
    in_float64()
    stiffness = float(values(law, np.array([mean]))[1][0])
    if not 0 < stiffness < np.inf:
        refuse(
            "mean",
            "a strain at which the law is stiff",
            f"{mean:g}, where its stiffness is {stiffness:g}",
            "Without a precompression the mean strain has to close the contacts.",
        )
    waves = _Family(law, mean, wavelength, stiffness, stiffness * np.sinc(1 / wavelength) ** 2)
    box = waves.box(POINTS[0])
    first = FIRST * _scale(law, mean, stiffness) * min(1.0, (COSINE / wavelength) ** 2)
    if speed is None:
        phi, level = _to_amplitude(waves, box, first, amplitude)
    else:
        phi, level = _to_speed(waves, box, first, mass, speed)
    before = None
    gaps = [np.inf]
    for points in POINTS:
        finer = waves.box(points)
        phi = fourier(phi, box.half, finer.x)
        found, level = waves.solved(finer, phi, level, amplitude)
        box = finer
        phi = found.phi
        if before is not None:
            gaps.append(float(np.abs(fourier(before, box.half, box.x) - phi).max()))
        apart = gaps[-1]
        if apart <= AGREE * found.top:
            break
        before = phi
    else:
        # The error depends on where a contact opens between two points, so that two resolutions may
        # agree by chance.
        apart = max(gaps[-2:])
    # The box begins at a trough.
    crests = np.count_nonzero(np.diff(2 * phi[0] > phi[0].max() + phi[0].min())) // 2
    if not (found.residual < CONVERGED and crests == 1):
        refuse(
            "wavelength",
            "one whose wave is found",
            f"{wavelength:g}, where Newton's method ends with a residual of "
            f"{found.residual:.1e} and {crests} crests",
            "A very long wave is a train of solitary waves, of gx.travelling.solitary_wave; "
            "if this one is short, the law may have no such wave.",
        )
    error = max(apart, ROUNDING * found.top)
    c = float(np.sqrt(level / mass))
    v = box.of_level(level).velocities(phi)
    # The displacement has mean zero.
    u = np.fft.ifft(1j * np.fft.fft(v, axis=1) / np.where(box.k == 0, 1, box.k), axis=1).real
    return Train(c, box.half, phi[0], c * v[0], u[0], mean, float(found.residual), error)


def _scale(law, mean, stiffness):
    # Return a strain over which the stiffness changes by half.
    steps = 2.0 ** np.arange(-160, 161)
    slope = values(law, np.stack([mean + steps, mean - steps]))[1]
    with np.errstate(invalid="ignore"):
        changed = ~(np.abs(slope / stiffness - 1) < 0.5).all(0)
    # Steps below the rounding of the mean give no information.
    changed &= steps > 1e-9 * abs(mean)
    if not changed.any():
        refuse(
            "law",
            "one that is not linear",
            "one whose waves have one speed",
            "Use gx.linear for their frequencies.",
        )
    return steps[np.argmax(changed)]


def _to_amplitude(waves, box, first, amplitude):
    reached = 0.0
    for *wave, reached in waves.growing(box, first, amplitude):
        if reached == amplitude:
            return wave
    refuse(
        "amplitude",
        f"one that the family reaches, up to about {reached:.3g}",
        f"{amplitude:g}",
        "Above it contacts may open within the wave.",
    )


def _to_speed(waves, box, first, mass, speed):
    wanted = mass * speed**2
    wave = None
    small = waves.small
    for new in waves.growing(box, first, np.inf):
        if (new[1] - wanted) * (small - wanted) <= 0:
            return _between(waves, box, wave, new, wanted)
        if wave is not None and abs(new[1] - wanted) > abs(wave[1] - wanted):
            break
        wave = new
    way = "below" if wave is not None and wave[1] < small else "above"
    refuse(
        "speed",
        f"one {way} that of small waves of this length, {np.sqrt(small / mass):.6g}, as far as their family goes",
        f"{speed:g}",
        "Give amplitude= to see which speeds it has.",
    )


def _between(waves, box, low, high, wanted):
    a, b = (0.0, waves.small) if low is None else (low[2] ** 2, low[1])
    square = a + (wanted - b) * (high[2] ** 2 - a) / (high[1] - b)
    return (waves.grown(box, np.sqrt(square), high) or high)[0], wanted
