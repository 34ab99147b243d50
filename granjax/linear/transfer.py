"""Localisation length of waves in disordered chains, by transfer matrices over many realisations."""

import jax
import jax.numpy as jnp
import numpy as np

from ..base.checks import described, known_value, positive, refuse, show
from ..base.programs import compiled, concretely
from ..base.types import Flags, Number, Parameter
from ..lattice import Lattice, spread_mass
from ..results import Result, array
from .losses import without_memory
from .stiffness import at_rest, blocks, components, grid, or_one, stand_in

# pieces of a chain in which growth is measured
PIECES = 36
# the first pieces, which remember the start and are dropped
FORGOTTEN = 4
# with so many lanes the standard error comes from the lanes alone
ENOUGH = 8
# forces that reach beyond the next site, and differences of the forces on both sites of a bond, are
# refused above this, in units of eps times the largest stiffness or damping
LOOSE = 1e6


class LocalisationLength(Result):
    """The Lyapunov exponent gamma of waves in a disordered chain, from `localisation_length`."""

    omega: Number = array("The frequencies.", "rad/s", "omega")
    gamma: Number = array(
        "The Lyapunov exponent per site, the inverse localisation length of the amplitude.",
        "1",
        "omega",
    )
    error: Number = array("The standard error of gamma.", "1", "omega")
    sites: int = array("The number of sites of each chain.")
    samples: int = array("The number of chains.")

    @property
    def length(self) -> Number:
        """The localisation length of the amplitude, 1/gamma [sites]."""
        return 1 / self.gamma

    @property
    def resolved(self) -> Flags:
        """Where gamma exceeds twice its standard error."""
        return self.gamma > 2 * self.error

    @property
    def outcome(self) -> str:
        """gamma and its error, the chains, and where no decay is seen."""
        gamma = np.asarray(self.gamma)
        error = np.asarray(self.error)
        of = f"from {self.samples} chain{'s' * (self.samples > 1)} of {self.sites} sites"
        unseen = int(np.sum(~self.resolved))
        if unseen == gamma.size:
            return f"No decay is seen: gamma is below twice its standard error, {of}."
        if not gamma.ndim:
            return f"gamma = {gamma:.5g} +- {error:.1g} per site, {of}."
        said = f"gamma from {gamma.min():.3g} to {gamma.max():.3g} per site, {of}; median error {np.median(error):.1g}"
        return f"{said}, {unseen} of {gamma.size} not told from zero." if unseen else f"{said}."


def localisation_length(lattice: Lattice, omega: Parameter) -> LocalisationLength:
    r"""Compute the decay rate of waves in a disordered chain, gamma = lim ln|u_n|/n.

    The chain is linearised about u = 0, with any law, on-site forces, and damping of sites and
    bonds; the walls are left out. With f_n = k_n (u_{n-1} - u_n),
    k_n = K_n - i omega c_n (c_n of a dashpot) and s_n = S_n - i omega g_n for what ties and damps
    site n,

        f_{n+1} = f_n + (m_n omega^2 - s_n) u_n,    u_{n+1} = u_n - f_{n+1}/k_{n+1},

    with the norm taken out at each site. Resonators (further fields, which no bond joins to the
    next site) add their response to s_n; `CaputoDamping` of order a adds c (-i omega)^a. Lanes are
    realisations:

        import jax, jax.numpy as jnp
        chains = jax.vmap(lambda n: gx.scenes.disordered(5000, 0.2, n, law=gx.Linear), out_axes=-1)(jnp.arange(64))
        gx.linear.localisation_length(chains, 0.5)

    **Arguments:** `lattice`: a chain of N sites with nearest-neighbour bonds, one or a batch.
    `omega` > 0 [rad/s], a number or an array.

    **Returns:** `LocalisationLength`, differentiable in omega and every parameter. The standard
    error is over the lanes, or for fewer than 8 lanes over 32 pieces of each chain; it is about
    (gamma/(sites of all chains))^{1/2}. The first ninth of each chain is dropped, to forget the
    start. In a gap and above the band gamma is the evanescent decay; with damping it is that of a
    driven wave, whether disorder or damping stops it. Cost: 10 to 40 ns per site, chain and
    frequency.
    **Raises** ValueError for fewer than four sites, vectors, bonds between several fields of next
    sites, bonds that reach further (use the participation of `normal_modes`), bonds without
    stiffness at rest (a sonic vacuum), and forces that differ between the sites of a bond
    (gyroscopic, one-way), have internal variables, or change in time.
    Source: Ishii, Prog. Theor. Phys. Suppl. 53, 77 (1973); closed form:
    `gx.theory.localisation.lyapunov_exponent`.

    **Example:**

    >>> chains = jax.vmap(lambda n: gx.scenes.disordered(500, 0.3, n, law=gx.Linear), out_axes=-1)(jnp.arange(16))
    >>> found = gx.linear.localisation_length(chains, 1.0)
    >>> gamma = gx.theory.localisation.lyapunov_exponent(1.0, mass_deviation=0.3 / 3**0.5)
    >>> round(float(gamma), 4), bool(abs(found.gamma - gamma) < 3 * found.error)
    (0.005, True)
    """
    omega = positive("omega", omega, "It is an angular frequency.")
    lattice, past = without_memory(lattice)
    lattice = at_rest(lattice, lanes=True)
    if lattice.dimension is not None or lattice.axes != 1:
        refuse("lattice", "a chain of scalar displacements", described(lattice.sites), _MODES)
    (sites,) = grid(lattice)
    if sites < 4:
        refuse("lattice", "at least four sites", f"{sites}", "The walls' sites are left out.")
    past = [(order, at_rest(one, lanes=True)) for order, one in past]
    how = _joined(lattice), lattice.reads_velocity
    gamma, error, *checks = _growth(lattice, past, omega.reshape(-1), *how)
    further, uneven, least = (known_value(x) for x in checks)
    tolerance = LOOSE * np.finfo(lattice.dtype).eps
    if further is not None and further > tolerance:
        wanted = "bonds and dashpots between next neighbours"
        refuse("lattice", wanted, "some that reach further", _MODES)
    if uneven is not None and uneven > tolerance:
        refuse(
            "lattice",
            "forces that act equally on both sites of a bond",
            "gyroscopic or one-way forces",
            "Waves to the left and to the right differ: simulate the chain, driven at one end.",
        )
    if least is not None and not least > 0:
        refuse(
            "lattice",
            "bonds with a stiffness at rest",
            f"one of stiffness {show(least)}",
            "A sonic vacuum has no linear waves: give precompression > 0, or see gx.measures.second_moment.",
        )
    samples = int(np.prod(lattice.lanes, dtype=int))
    shape = omega.shape
    return LocalisationLength(omega, gamma.reshape(shape), error.reshape(shape), sites, samples)


_MODES = "gx.measures.participation of normal modes tells how far such waves reach."


def _joined(lattice):
    # the index of the field that bonds join to the next site
    if components(lattice) == 1:
        return 0
    found = np.asarray(concretely(_blocks, stand_in(lattice)[0], False)[0])
    beside = np.abs(found[:, ::2]).max((0, 1, *range(4, found.ndim)))
    joined = np.flatnonzero(beside.any(0) | beside.any(1))
    if len(joined) != 1:
        refuse("lattice", "bonds that join one field to the next site", f"{len(joined)}", _MODES)
    return int(joined[0])


@compiled
def _blocks(lattice, damped):
    # the blocks (N, 3, F, F, maps, 1) and lanes, and what they miss
    of = lambda lattice: blocks(lattice, (1,), jnp.zeros(1, lattice.dtype), damped)[::2]
    for _ in lattice.lanes:
        of = jax.vmap(of, -1, -1)
    return of(lattice)


@compiled
# the checks: what three diagonals miss, their asymmetry, and the least |k_n|, over the largest
# entry
def _growth(lattice, past, omega, joined, damped):
    # gamma and its standard error (W,), and the checks
    fields = [joined, *(i for i in range(components(lattice)) if i != joined)]
    (tied, k), further, uneven, scale = _springs(lattice, fields, damped)
    masses = jax.tree.leaves(spread_mass(lattice))
    mass = jnp.stack([masses[i][1:-1].reshape(len(k), -1) for i in fields], 1)
    memory = [_springs(one, fields, True)[0][0][:, :, :, 1] for _, one in past]
    count = k.shape[0]
    lanes = k.shape[-1]
    pieces = min(PIECES, count)
    forgotten = pieces * FORGOTTEN // PIECES
    length = count // pieces
    begin = count - pieces * length

    def cut(x):
        return x[begin:].reshape(pieces, length, *x.shape[1:-1], 1, lanes)

    omega = omega[:, None]
    slow = [(-1j * omega) ** jnp.ravel(order) for order, _ in past]

    def response(m, s, k, memory):
        # the dynamic stiffness of a site's joined field, the others eliminated, and of k
        lossy = lambda x: x[0] - 1j * omega * x[1] if damped else x[0]
        Z = lossy(jnp.moveaxis(s, 2, 0)) + sum(a * c for a, c in zip(slow, memory))
        Z = Z - omega**2 * m[:, None] * np.eye(len(fields))[..., None, None]
        for last in range(len(fields) - 1, 0, -1):
            Z = Z[:last, :last] - Z[:last, last:] * Z[last:, :last] / Z[last, last]
        return Z[0, 0], lossy(k)

    # In the band of the mean chain, W = -Z/k from 0 to 4, its conserved form of (u, g = f/k) is
    # W u^2 + W u g + g^2 = (W - W^2/4) u^2 + (g + W u/2)^2. Another norm would rise and fall along
    # it, by more than a short chain grows.
    Z, k_mean = response(*jax.tree.map(_mean, (mass, tied, k, memory)))
    W = -Z.real / k_mean.real
    inside = (W > 0) & (W < 4)
    impedance = omega * jnp.sqrt(mass[:, 0].mean() * k[:, 0].mean())
    scale_u = jnp.sqrt(jnp.where(inside, W - W * W / 4, 1))
    compliance = 1 / jnp.where(inside, k_mean.real, impedance)
    slope = jnp.where(inside, W / 2, 0)
    phase = np.pi * (np.arange(lanes) + 0.5) / lanes
    u = jnp.cos(phase) / scale_u
    start = u, (jnp.sin(phase) - slope * u) / compliance
    start = tuple(x + 0j for x in start) if damped or past else start

    def site(carry, row):
        u, f, grown = carry
        Z, k = response(*row)
        f = f - Z * u
        u = u - f / k
        size = jnp.sqrt(_squared(scale_u * u) + _squared(compliance * f + slope * u))
        return (u / size, f / size, grown + jnp.log(size)), jnp.log(size).mean(-1)

    def piece(carry, rows):
        (u, f, grown), steps = jax.lax.scan(site, (*carry, 0 * carry[0].real), rows)
        # how far the growth leaves a straight line
        left = jnp.cumsum(steps - steps.mean(0), 0)
        return (u, f), (grown / length, left.max(0), left.min(0))

    rows = jax.tree.map(cut, (mass, tied, k, memory))
    rates, high, low = (x[forgotten:] for x in jax.lax.scan(piece, start, rows)[1])
    used = length * len(rates)
    gamma = rates.mean((0, -1))
    # The norm also rises and falls along the chain, alike in all lanes where cells have several
    # sites; both ends of the run meet it anywhere within.
    ends = jnp.cumsum(rates.mean(-1) - gamma, 0) * length
    ends = jnp.stack([ends, jnp.roll(ends, 1, 0).at[0].set(0)])
    swing = (ends.max(0) + high).max(0) - (ends.min(0) + low).min(0)
    rates = rates.mean(0) if lanes >= ENOUGH else jnp.moveaxis(rates, 1, 0).reshape(len(omega), -1)
    error = jnp.hypot(rates.std(-1, ddof=1) / np.sqrt(rates.shape[-1]), swing / (2 * used))
    if damped or past:
        # The start holds two waves alike, and until the one that shrinks is forgotten the norm,
        # cosh(2 lost n)^{1/2} without disorder, grows less than the other. With disorder the
        # correction is not exact.
        lost = jnp.abs(jnp.arccos(1 + Z / k_mean / 2).imag)
        both = jnp.log1p(jnp.exp(-4 * lost[:, 0] * length * np.array([[forgotten], [pieces]])))
        slower = jnp.where(inside[:, 0], both[0] - both[1], 0) / (2 * used)
        gamma = gamma + slower
        error = jnp.hypot(error, slower / 2)
    # the rounding of a logarithm, and of a sum that grows over a piece, half of a unit each at most
    error = jnp.maximum(error, jnp.finfo(error.dtype).eps * (4 + gamma * length / 4))
    return gamma, error, further, uneven, jnp.abs(k[:, 0]).min() / scale


def _mean(x):
    # over sites and lanes
    return x.mean((0, -1))[..., None, None]


def _squared(x):
    return x.real**2 + x.imag**2


def _springs(lattice, fields, damped):
    # of the sites but the ends, with the fields in the given order: on-site (N - 2, F, F, maps,
    # lanes), of the first field to the right (N - 2, maps, lanes); then the checks, and the largest
    # entry of the springs
    found, further = _blocks(lattice, damped)
    maps = 1 + damped
    rows = found[1:-1, :, np.array(fields)][:, :, :, np.array(fields)]
    rows = rows.reshape(*rows.shape[:4], maps, -1)
    left, own, right = jnp.moveaxis(rows, 1, 0)
    scale = or_one(jnp.abs(rows[:, 1:]).max((0, 1, 2, 3, 5)))
    uneven = jnp.abs(left[1:] - right[:-1]).max((0, 1, 2, 4)) / scale
    return (left + own + right, -right[:, 0, 0]), further.max(), uneven.max(), scale[0]
