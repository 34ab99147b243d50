"""Derivatives of runs: in both modes scene by scene, and with their error; kinks, what cannot be meant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import ended
from jax.flatten_util import ravel_pytree
from refusals import refused

import granjax as gx

slow = pytest.mark.slow


def struck(p, step):
    """Where the end of three beads is, by stiffness: contacts without preload that are straight lines, with a kink."""
    chain = gx.scenes.monomer(3, stiffness=p["stiffness"], exponent=1.0, boundary="free")
    return gx.simulate(chain, gx.states.impact(chain), 6.0, step=step).final.u[1:]


def shaken(stiffness, step):
    chain = gx.scenes.monomer(3, stiffness=stiffness, precompression=1.0)
    return gx.simulate(chain, gx.states.impact(chain, velocity=0.1), 6.0, step=step).final.u[1]


@slow
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


@slow
def test_a_smooth_derivative_is_known():
    found, fine = (gx.derivative(shaken, 1.3, step) for step in (0.2, 0.02))
    assert abs(float(found.value - fine.value)) <= float(found.error) < 1e-7
    assert found.relative < 1e-5 and found.outcome.startswith("The derivative is known to")
    assert "kink" not in repr(found) and float(fine.error) < 1e-12


@slow
def test_saved_times_that_shorten_all_steps_alike_hide_no_error():
    """The distance to saved times is half of the step, so the steps of the ladder would be one."""

    def kinked(k, step, **saved):
        chain = gx.Lattice(
            1.0, gx.Bond(gx.Shift(1, "fixed"), gx.PowerLaw(k, 1.0, 0.05 * k)), sites=4
        )
        return gx.simulate(
            chain, gx.State(jnp.zeros(4), jnp.eye(4)[0]), 4.0, step=step, **saved
        ).final.u

    fine = jax.jacfwd(kinked)(1.0, 5e-4)
    for step, frames in ((0.2, 41), (0.1, 41), (0.08, 51)):
        found = gx.derivative(lambda k, h, frames=frames: kinked(k, h, save_at=frames), 1.0, step)
        assert (np.abs(found.value - fine) <= found.error).all() and "kink" in found.outcome
    # beside a part that tells its steps apart, and where no step can be chosen
    both = gx.derivative(
        lambda k, h: {"free": kinked(k, h), "saved": kinked(k, h, save_at=41)}, 1.0, 0.2
    )
    assert (np.abs(both.value["saved"] - fine) <= both.error["saved"]).all()
    within = jax.jit(lambda k: gx.derivative(lambda k, h: kinked(k, h, save_at=41), k, 0.2).error)
    assert np.isinf(within(1.0)).all()


def test_each_part_of_a_derivative_is_known_to_a_share_of_its_own_size():
    large = gx.derivative(
        lambda x, h: {"a": 1e9 * x * (1 + 1e-6 * h), "b": x * (1 + 3 * h)}, 1.0, 0.1
    )
    assert large.relative > 0.1
    lost = gx.derivative(lambda x, h: {"a": x**2, "b": jnp.sqrt(-x)}, 1.0, 0.1)
    assert lost.outcome == "The derivative is not finite."
    rounded = gx.derivative(lambda x, h: {"a": x * (1 + 1e-9 * h), "b": 1e-16 * x * h}, 1.0, 0.1)
    assert rounded.relative < 1e-3
    exact = gx.derivative(lambda x, h: x**2, 1.0, 0.1)
    assert exact.error == 0 and exact.outcome.startswith("The derivative is the same at all steps")


def test_a_derivative_at_no_step_is_refused():
    with refused("step: expected numbers above zero"):
        gx.derivative(shaken, 1.0, 0.0)


@slow
def test_the_bound_on_the_frequency_has_both_modes():
    """Alike, where a neighbourhood does not hold the whole chain; runs take it as a choice, without a derivative."""

    def bound(F0):
        chain = gx.scenes.monomer(17, precompression=F0)
        return gx.flow.frequency_bound(chain, gx.states.impact(chain, velocity=0.1), 0.0, 1.0)

    assert jax.jacfwd(bound)(1.0) == pytest.approx(float(jax.grad(bound)(1.0)), rel=1e-12)


# gradients of runs, scene by scene ---------------------------------------------------------------------------------
# a scene: its lattice from a parameter p and a number of sites, and the accelerations a(t, u, v, p) in plain NumPy

T1 = 2.0
KICK = 0.2
H = 1e-4
PHASE = 1.7, 0.4
WAYS = {"default": {}, "step": {"step": 0.05}, "tolerance": {"tolerance": 1e-8}}


def swing(t):
    return np.cos(PHASE[0] * t + PHASE[1])


def joined(force, u, boundary="fixed"):
    """Forces on the sites of a chain from those of its bonds."""
    wide = {"fixed": np.pad(u, 1), "periodic": np.pad(u, 1, "wrap"), "free": np.pad(u, 1, "edge")}
    f = force(-np.diff(wide[boundary]))
    return f[:-1] - f[1:]


def hertz(e, A=1.0, F0=1.0):
    return A * np.maximum((F0 / A) ** (2 / 3) + e, 0) ** 1.5 - F0


def chain(p, n, law, boundary="fixed", *terms):
    return gx.Lattice(1.0, (gx.Bond(gx.Shift(1, boundary), law), *terms), sites=n)


def swinging_pendula(p, n):
    terms = gx.OnSite(gx.Sine()), gx.Damping(0.05), gx.Drive(gx.Harmonic(0.1 * p, *PHASE), 4)
    return chain(p, n, gx.Linear(0.3 * p), "fixed", *terms)


def swinging_pendula_force(t, u, v, p):
    push = 0.1 * p * swing(t) * (np.arange(len(u)) == 4)
    return joined(lambda e: 0.3 * p * e, u) - np.sin(u) - 0.05 * v + push


def dashpots(p, n):
    return chain(p, n, gx.Hertz(1.0, 1.0), "fixed", gx.Dashpot(gx.Shift(1, "fixed"), 0.1 * p))


def three_fields(p, n):
    tie = lambda other, k: gx.Bond(gx.Shift(0, "free", ("bead", other)), gx.Linear(k))
    mass = {"bead": np.ones(n), "inner": np.full(n, 0.3), "outer": np.full(n, 0.2)}
    beads = gx.Bond(gx.Shift(1, "fixed", "bead"), gx.Hertz(1.0, 1.0))
    return gx.Lattice(mass, (beads, tie("inner", p), tie("outer", 0.5)))


def three_fields_force(t, u, v, p):
    bead, inner, outer = np.split(u, 3)
    a = p * (bead - inner)
    b = 0.5 * (bead - outer)
    return np.concatenate([joined(hertz, bead) - a - b, a / 0.3, b / 0.2])


def plane(p, n):
    bonds = (
        gx.Bond(gx.Stretch(gx.Shift((i, 1 - i), "periodic"), [float(i), 1.0 - i]), gx.Linear(k))
        for i, k in ((1, p), (0, 0.7))
    )
    return gx.Lattice(1.0, tuple(bonds), sites=(n // 4, 4), dimension=2)


def plane_force(t, u, v, p):
    u = u.reshape(-1, 4, 2)
    total = np.zeros_like(u)
    for axis, k in ((0, p), (1, 0.7)):
        d = np.roll(u, -1, axis) - u + np.eye(2)[axis]
        length = np.sqrt((d * d).sum(-1, keepdims=True))
        pull = k * (length - 1) * d / length
        total += pull - np.roll(pull, 1, axis)
    return total.ravel()


SCENES = {
    "loaded beads": (
        lambda p, n: chain(p, n, gx.Hertz(1.0, p)),
        lambda t, u, v, p: joined(lambda e: hertz(e, F0=p), u),
    ),
    "sonic vacuum": (
        lambda p, n: chain(p, n, gx.Hertz(p), "free"),
        lambda t, u, v, p: joined(lambda e: hertz(e, p, 0.0), u, "free"),
    ),
    "FPUT ring": (
        lambda p, n: chain(p, n, gx.Polynomial(1.0, 0.25 * p, 0.1), "periodic"),
        lambda t, u, v, p: joined(lambda e: e + 0.25 * p * e**2 + 0.1 * e**3, u, "periodic"),
    ),
    "swinging pendula": (swinging_pendula, swinging_pendula_force),
    "dashpots": (
        dashpots,
        lambda t, u, v, p: joined(hertz, u) + joined(lambda rate: 0.1 * p * rate, v),
    ),
    "three fields": (three_fields, three_fields_force),
    "plane": (plane, plane_force),
}
# each scene once; more sites than a neighbourhood, from which the default step comes; each way
OFTEN = "loaded beads", "FPUT ring", "three fields"
ROWS = [(case, "step", 8) for case in SCENES if case not in OFTEN]
ROWS += [("FPUT ring", "default", 40), ("three fields", "default", 40)]
ROWS += [("loaded beads", "tolerance", 8)]


def kicked(lattice, speed):
    """At rest but for a narrow bump of velocities; sites of a field in their order, whatever the axes."""
    one = lambda x: speed * jnp.exp(-0.5 * (jnp.arange(x.size) - 2.0) ** 2).reshape(x.shape)
    return gx.State(lattice.zeros(), jax.tree.map(one, lattice.zeros()))


def weighed(y):
    """A number that hangs on every entry of a state."""
    flat, _ = ravel_pytree(y)
    return flat @ np.cos(1.0 + np.arange(flat.size))


def by_differences(case, n):
    """d/d(p, speed) by central differences of DOP853."""
    make, force = SCENES[case]
    u, v = (np.asarray(ravel_pytree(x)[0]) for x in kicked(make(1.0, n), 1.0))

    def end(p, speed):
        field = lambda t, y: np.concatenate([y[u.size :], force(t, *np.split(y, 2), p)])
        return float(weighed(ended(field, T1, np.concatenate([u, speed * v]))))

    x = np.array([1.0, KICK])
    return np.array([(end(*(x + H * e)) - end(*(x - H * e))) / (2 * H) for e in np.eye(2)])


@slow
@pytest.mark.parametrize(("case", "how", "n"), ROWS)
def test_gradients_of_runs_are_those_of_differences(case, how, n):
    """Forward and in reverse, to the error of the runs, which is largest where contacts open."""

    def end(x):
        lattice = SCENES[case][0](x[0], n)
        return weighed(gx.simulate(lattice, kicked(lattice, x[1]), T1, **WAYS[how]).final)

    want = by_differences(case, n)
    x = jnp.array([1.0, KICK])
    for derive in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(derive(end)(x), want, rtol=0, atol=3e-7 * np.abs(want).max())


def test_few_loops_are_nested_around_a_step_whose_number_is_traced():
    """Each is one more copy of the step in the program of a gradient; up to 2^24 steps take four."""

    def end(stiffness):
        chain = gx.scenes.monomer(3, stiffness=stiffness, precompression=1.0)
        return gx.simulate(chain, gx.states.impact(chain, 0.1), 6.0).final.u[1]

    def depth(program):
        loops = [0]
        for equation in program.eqns:
            inner = [x for x in jax.tree.leaves(equation.params, is_leaf=traced) if traced(x)]
            loop = equation.primitive.name == "scan"
            loops.append(max(map(depth, inner), default=0) + loop)
        return max(loops)

    traced = lambda x: hasattr(x, "eqns")
    # the innermost one is over the stages
    assert depth(jax.make_jaxpr(end)(1.0)) == 4 + 1


@slow
@pytest.mark.parametrize("exponent", [1.5, 1.37])
def test_the_hessian_of_a_run_is_that_of_differences(exponent):
    """By `jax.hessian` and forward twice, in a sonic vacuum, whose slopes change as steeply as s^(p-2)."""

    def end(x):
        chain = gx.scenes.monomer(4, stiffness=x[0], exponent=exponent, boundary="free")
        return gx.simulate(chain, gx.states.impact(chain, x[1]), 4.0, step=0.02).final.u[2]

    x = jnp.array([1.0, 0.7])
    slope = jax.jit(jax.jacfwd(end))
    want = np.array([(slope(x + H * e) - slope(x - H * e)) / (2 * H) for e in np.eye(2)])
    for second in (jax.hessian(end), jax.jacfwd(slope)):
        np.testing.assert_allclose(second(x), want, rtol=0, atol=1e-4 * np.abs(want).max())
