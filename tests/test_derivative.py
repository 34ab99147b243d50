"""Derivatives of runs: in both modes scene by scene, and with their error; kinks, what cannot be meant."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granjax as gx


def struck(p, step):
    """Where the end of three beads is, by stiffness: contacts without preload that are straight lines, with a kink."""
    chain = gx.scenes.monomer(3, stiffness=p["stiffness"], exponent=1.0, boundary="free")
    return gx.simulate(chain, gx.states.impact(chain), 6.0, step=step).final.u[1:]


def shaken(stiffness, step):
    chain = gx.scenes.monomer(3, stiffness=stiffness, precompression=1.0)
    return gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 6.0, step=step).final.u[1]


@pytest.mark.study
def test_a_kink_shows():
    """Against differences of runs at a fine step, whose error is of second order: within the error, which is large."""
    largest = 0.0
    for A in np.linspace(0.7, 1.4, 8):
        found = gx.derivative(struck, {"stiffness": A}, 0.3)
        ends = [struck({"stiffness": jnp.asarray(A + d)}, 0.002) for d in (1e-3, -1e-3)]
        missed = np.abs(found.value["stiffness"] - (ends[0] - ends[1]) / 2e-3)
        assert (missed <= found.error["stiffness"]).all()
        largest = max(largest, float(np.max(missed / np.abs(found.value["stiffness"]))))
        assert found.slopes["stiffness"].shape == (6, 2) and "kink" in found.outcome
    assert largest > 0.02


@pytest.mark.slow
def test_a_smooth_derivative_is_known():
    found = gx.derivative(shaken, 1.3, 0.2)
    fine = gx.derivative(shaken, 1.3, 0.02)
    assert abs(float(found.value - fine.value)) <= float(found.error) < 1e-7
    assert found.relative < 1e-5 and found.outcome.startswith("The derivative is known to")
    assert "kink" not in repr(found) and float(fine.error) < 1e-12


def test_what_has_no_derivative_is_refused():
    with pytest.raises(ValueError, match="step: expected numbers above zero"):
        gx.derivative(shaken, 1.0, 0.0)


# ------------------------------------------------------------------------------- gradients of runs, scene by scene
# a scene: (its lattice from a parameter p and a number of sites, m a = F in plain NumPy); p = 1, some sites are kicked

T1, KICK, H = 2.0, 0.2, 1e-4
SHAKE = 1.7, 0.4
WAYS = {"default": {}, "step": {"step": 0.05}, "tolerance": {"tolerance": 1e-8}}


def joined(force, boundary="fixed"):
    """Forces on the sites of a chain from those of its bonds."""

    def of(u, p):
        wide = {"fixed": np.pad(u, 1), "free": u, "periodic": np.append(u[-1], np.append(u, u[0]))}[
            boundary
        ]
        f = force(wide[:-1] - wide[1:], p)
        return np.diff(-f) if boundary != "free" else np.diff(-np.pad(f, 1))

    return of


def hertz(A=1.0, F0=1.0):
    return lambda e, p=1.0: A * np.maximum((F0 / A) ** (2 / 3) + e, 0) ** 1.5 - F0


def grid(p, n):
    bonds = (
        gx.Bond(gx.Stretch(gx.Shift((i, 1 - i), "periodic"), [float(i), 1.0 - i]), gx.Linear(k))
        for i, k in ((1, p), (0, 0.7))
    )
    return gx.Lattice(1.0, tuple(bonds), sites=(n // 4, 4), dimension=2)


def grid_force(t, u, v, p):
    u = u.reshape(-1, 4, 2)
    total = np.zeros_like(u)
    for axis, k in ((0, p), (1, 0.7)):
        d = np.roll(u, -1, axis) - u + np.eye(2)[axis]
        length = np.sqrt((d * d).sum(-1, keepdims=True))
        pull = k * (length - 1) * d / length
        total += pull - np.roll(pull, 1, axis)
    return total.ravel()


def three_fields(p, n):
    tie = lambda other, k: gx.Bond(gx.Shift(0, "free", ("bead", other)), gx.Linear(k))
    mass = {"bead": np.ones(n), "inner": np.full(n, 0.3), "outer": np.full(n, 0.2)}
    chain = gx.Bond(gx.Shift(1, "fixed", "bead"), gx.Hertz(1.0, 1.0))
    return gx.Lattice(mass, (chain, tie("inner", p), tie("outer", 0.5)))


def three_fields_force(t, u, v, p):
    bead, inner, outer = np.split(u, 3)
    a, b = p * (bead - inner), 0.5 * (bead - outer)
    return np.concatenate([joined(hertz())(bead, p) - a - b, a / 0.3, b / 0.2])


def shaken_wall(p, n):
    ends = (
        gx.Wall(gx.Hertz(1.0, 1.0), side, motion=motion)
        for side, motion in (("left", gx.Harmonic(0.1 * p, *SHAKE)), ("right", None))
    )
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 1.0)), *ends), sites=n)


def shaken_wall_force(t, u, v, p):
    f = hertz()(-np.diff(np.concatenate([[0.1 * p * np.cos(SHAKE[0] * t + SHAKE[1])], u, [0.0]])))
    return f[:-1] - f[1:]


def ring(p, n):
    return gx.Lattice(
        1.0,
        gx.LongRange(np.arange(1.0, n // 2) ** -3, gx.Polynomial(p, 0.3, 0.2), "periodic"),
        sites=n,
    )


def ring_force(t, u, v, p):
    total = np.zeros_like(u)
    for m in range(1, len(u) // 2):
        e = u - np.roll(u, -m)
        f = m**-3.0 * (p * e + 0.3 * e**2 + 0.2 * e**3)
        total += np.roll(f, m) - f
    return total


def site(n, i, f):
    return f * (np.arange(n) == i)


class Stiffening(gx.laws.Law):
    """A law of a user's own: F = k e (1 + tanh(e)^2)."""

    k: jax.Array

    def force(self, e):
        return self.k * e * (1 + jnp.tanh(e) ** 2)

    def energy(self, e):
        return self.k * (e * e - e * jnp.tanh(e) + jnp.log(jnp.cosh(e)))


def of_bonds(law, boundary="fixed", *terms):
    return lambda p, n: gx.Lattice(
        1.0, (gx.Bond(gx.Shift(1, boundary), law(p)), *(term(p) for term in terms)), sites=n
    )


SCENES = {
    "loaded beads": (
        of_bonds(lambda p: gx.Hertz(1.0, p)),
        lambda t, u, v, p: joined(hertz(F0=p))(u, p),
    ),
    "sonic vacuum": (
        of_bonds(lambda p: gx.Hertz(p), "free"),
        lambda t, u, v, p: joined(lambda e, p: p * np.maximum(e, 0) ** 1.5, "free")(u, p),
    ),
    "FPUT ring": (
        of_bonds(lambda p: gx.Polynomial(1.0, 0.25 * p, 0.1), "periodic"),
        lambda t, u, v, p: joined(lambda e, p: e + 0.25 * p * e**2 + 0.1 * e**3, "periodic")(u, p),
    ),
    "magnets": (
        of_bonds(lambda p: gx.PowerLaw(1.0, -3.0, p)),
        lambda t, u, v, p: joined(lambda e, p: (p ** (-1 / 3) - e) ** -3 - p)(u, p),
    ),
    "own law": (
        of_bonds(Stiffening),
        lambda t, u, v, p: joined(lambda e, p: p * e * (1 + np.tanh(e) ** 2))(u, p),
    ),
    "pendula": (
        of_bonds(lambda p: gx.Linear(0.3 * p), "fixed", lambda p: gx.OnSite(gx.Sine())),
        lambda t, u, v, p: joined(lambda e, p: 0.3 * p * e)(u, p) - np.sin(u),
    ),
    "driven": (
        of_bonds(
            lambda p: gx.Hertz(1.0, 1.0),
            "fixed",
            lambda p: gx.Damping(0.05),
            lambda p: gx.Drive(gx.Harmonic(0.1 * p, *SHAKE), 4),
        ),
        lambda t, u, v, p: (
            joined(hertz())(u, p)
            - 0.05 * v
            + site(len(u), 4, 0.1 * p * np.cos(SHAKE[0] * t + SHAKE[1]))
        ),
    ),
    "dashpots": (
        of_bonds(
            lambda p: gx.Hertz(1.0, 1.0),
            "fixed",
            lambda p: gx.Dashpot(gx.Shift(1, "fixed"), 0.1 * p),
        ),
        lambda t, u, v, p: joined(hertz())(u, p) + joined(lambda e, p: 0.1 * p * e)(v, p),
    ),
    "modulated": (
        lambda p, n: gx.Lattice(
            1.0,
            gx.Modulated(
                gx.Bond(gx.Shift(1, "periodic"), gx.Hertz(1.0, 1.0)),
                gx.Harmonic(0.3 * p, *SHAKE, mean=1.0),
            ),
            sites=n,
        ),
        lambda t, u, v, p: (
            (1 + 0.3 * p * np.cos(SHAKE[0] * t + SHAKE[1])) * joined(hertz(), "periodic")(u, p)
        ),
    ),
    "shaken wall": (shaken_wall, shaken_wall_force),
    "three fields": (three_fields, three_fields_force),
    "long range": (ring, ring_force),
    "plane": (grid, grid_force),
}


def kicked(lattice, speed):
    """At rest but for a narrow bump of velocities; sites of a field in their order, whatever the axes."""
    one = lambda x: speed * jnp.exp(-0.5 * (jnp.arange(x.size) - 2.0) ** 2).reshape(x.shape)
    return gx.State(lattice.zeros(), jax.tree.map(one, lattice.zeros()))


def weighed(y):
    """A number that hangs on every entry of a state."""
    return sum((x.ravel() * np.cos(1.0 + np.arange(x.size))).sum() for x in jax.tree.leaves(y))


def by_differences(case, n):
    """d/d(p, speed) by central differences of DOP853."""
    make, force = SCENES[case]
    shapes = [x.shape for x in jax.tree.leaves(make(1.0, n).zeros())]
    cuts = np.cumsum([np.prod(shape) for shape in shapes])
    size = cuts[-1]

    def end(p, speed):
        v = np.concatenate(
            [speed * np.exp(-0.5 * (np.arange(np.prod(shape)) - 2.0) ** 2) for shape in shapes]
        )
        field = lambda t, y: np.concatenate([y[size:], force(t, y[:size], y[size:], p)])
        y = solve_ivp(
            field, (0, T1), np.concatenate([0 * v, v]), method="DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]
        return weighed(np.split(y[:size], cuts[:-1]) + np.split(y[size:], cuts[:-1]))

    x = np.array([1.0, KICK])
    return np.array([(end(*(x + H * e)) - end(*(x - H * e))) / (2 * H) for e in np.eye(2)])


def test_the_bound_on_the_frequency_has_both_modes():
    """Alike, where a neighbourhood does not hold the whole chain; runs take it as a choice, without a derivative."""

    def bound(F0):
        chain = gx.scenes.monomer(17, precompression=F0)
        return gx.flow.frequency_bound(chain, gx.states.impact(chain, velocity=0.1), 0.0, 1.0)

    assert jax.jacfwd(bound)(1.0) == pytest.approx(float(jax.grad(bound)(1.0)), rel=1e-12)


def rows():
    """One runs always, three kinds of scenes with more sites than a neighbourhood after it; all the rest is a study."""
    often = {("loaded beads", how) for how in WAYS} | {
        ("three fields", "default"),
        ("plane", "default"),
    }
    for case, how, n in itertools.product(SCENES, WAYS, (8, 40)):
        mark = pytest.mark.slow if n == 40 and (case, how) in often else pytest.mark.study
        marks = () if (case, how, n) == ("FPUT ring", "default", 40) else mark
        yield pytest.param(case, how, n, marks=marks, id=f"{case}-{how}-{n}")


@pytest.mark.parametrize(("case", "how", "n"), list(rows()))
def test_gradients_of_runs_are_those_of_differences(case, how, n):
    """Forward and in reverse, to the error of the runs, which is largest where contacts open."""

    def end(x):
        lattice = SCENES[case][0](x[0], n)
        return weighed(gx.simulate(lattice, kicked(lattice, x[1]), T1, **WAYS[how]).final)

    want, x = by_differences(case, n), jnp.array([1.0, KICK])
    for derive in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(derive(end)(x), want, rtol=0, atol=3e-7 * np.abs(want).max())
