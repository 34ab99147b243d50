"""Lanes that stand before the sites, and numbers that change outside of a function after it was compiled."""

import functools
import types

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import granjax as gx
from granjax.continuation import continuation
from granjax.newton import newton
from granjax.outside import Outside

SIZE, TABLE = 1.0, np.ones(3)
SETTINGS = types.SimpleNamespace(size=1.0, other="x")
SHIFT = gx.Shift(1, "fixed")


def make(k, sites=4):
    return gx.Lattice(jnp.linspace(1.0, 2.0, sites), (gx.Bond(SHIFT, gx.Linear(k)), gx.Damping(0.1)))


@pytest.mark.parametrize("lanes", [1, 3, 4, 5])
@pytest.mark.parametrize("use", [
    lambda lattice: gx.simulate(lattice, (np.zeros((4, 4)),) * 2, 1.0),
    lambda lattice: gx.states.impact(lattice),
    lambda lattice: gx.linear.normal_modes(lattice),
    lambda lattice: lattice.zeros(),
    lambda lattice: lattice.force(0.0, np.zeros((4, 4)), np.zeros((4, 4))),
    lambda lattice: gx.Flow(2)((np.zeros((4, 4)),) * 2, 0.0, 1.0, lattice),
    lambda lattice: diffrax.diffeqsolve(diffrax.ODETerm(gx.vector_field), gx.KahanLi8(), 0.0, 1.0, 0.1,
                                        gx.State(jnp.zeros((4, 4)), jnp.zeros((4, 4))), args=lattice),
], ids=["simulate", "impact", "modes", "zeros", "force", "flow", "diffrax"])
def test_lanes_before_the_sites_are_refused_however_many(lanes, use):
    with pytest.raises(ValueError, match=r"lattice: expected lanes behind the sites.*out_axes=-1"):
        use(jax.vmap(make)(jnp.linspace(1.0, 2.0, lanes)))


def test_lanes_behind_the_sites_and_a_vmap_of_everything_pass():
    ks = jnp.linspace(1.0, 2.0, 4)
    behind, before = jax.vmap(make, out_axes=-1)(ks), jax.vmap(make)(ks)
    last = lambda lattice: lattice.acceleration(0.0, jnp.eye(4)[0], jnp.zeros(4))
    expected = np.stack([last(make(k)) for k in ks])
    assert behind.lanes == (4,) and behind.zeros().shape == (4, 4)
    np.testing.assert_array_equal(jax.vmap(last)(before), expected)
    np.testing.assert_array_equal(jax.vmap(last, in_axes=-1)(behind), expected)
    assert jax.tree.map(lambda x: x[..., 0], behind).lanes == ()
    stacked = jax.tree.map(lambda *x: jnp.stack(x, -1), *(make(k) for k in ks))
    np.testing.assert_array_equal(stacked.mass, behind.mass)
    nested = jax.vmap(jax.vmap(make, out_axes=-1), out_axes=-1)(jnp.ones((2, 3)))
    assert stacked.lanes == (4,) and nested.lanes == (3, 2)


def test_lanes_of_single_numbers_have_but_one_place():
    scene = lambda k: gx.scenes.monomer(3, stiffness=k)
    before, behind = jax.vmap(scene)(jnp.ones(3)), jax.vmap(scene, out_axes=-1)(jnp.ones(3))
    assert before.lanes == behind.lanes == (3,) and before.zeros().shape == (3, 3)
    assert jax.tree.map(lambda x: x[..., 0], before).lanes == ()
    cell = lambda k: gx.Lattice({"bead": jnp.ones(3), "resonator": k}, (), sites=3)
    with pytest.raises(ValueError, match="lanes behind"):
        jax.vmap(cell)(jnp.ones(3)).zeros()
    assert jax.vmap(cell, out_axes=-1)(jnp.ones(3)).lanes == (3,)


def test_a_state_without_the_lanes_of_its_lattice_is_refused():
    lattice = jax.vmap(make, out_axes=-1)(jnp.ones(4))
    with pytest.raises(ValueError, match=r"u: expected shape \(4, 4\)"):
        lattice.force(0.0, np.zeros(4), np.zeros(4))


def test_lanes_between_the_axes_of_a_grid_are_refused():
    bonds = gx.Bond(gx.Shift((1, 0), "fixed"), gx.Linear(jnp.ones((3, 2))))
    lattice = jax.vmap(lambda m: gx.Lattice(m * jnp.ones((2, 2)), bonds), out_axes=1)
    with pytest.raises(ValueError, match="lanes behind"):
        lattice(jnp.ones(2)).zeros()


def test_the_mark_costs_a_program_nothing():
    lattice = make(1.0)
    program = jax.make_jaxpr(lambda lattice, u: lattice.force(0.0, u, u))(lattice, jnp.ones(4)).jaxpr
    mark = program.invars[[leaf is lattice._mark for leaf in jax.tree.leaves(lattice)].index(True)]
    assert mark.aval.shape == (1,) and not any(mark is x for eqn in program.eqns for x in eqn.invars)
    assert lattice.astype(jnp.float32).dtype == jnp.float32


def wave(t):
    return SIZE * jnp.cos(t)


def caller(t):
    return wave(t)


def of_settings(t):
    return SETTINGS.size * jnp.cos(t)


def of_table(t):
    return TABLE[0] * jnp.cos(t)


class Size:
    size = 1.0


class Half(Size):
    pass


def of_class(t):
    return Half.size * jnp.cos(t)


class Swing:
    def __init__(self):
        self.size = 1.0

    def __call__(self, t):
        return SIZE * self.size * jnp.cos(t)


SWING = Swing()


def closed_over():
    size = 1.0

    def set_size(x):
        nonlocal size
        size = x

    return (lambda t: size * jnp.cos(t)), set_size


def set_global(x):
    global SIZE
    SIZE = x


compiled = jax.jit(lambda lattice: lattice.force(0.0, lattice.zeros(), lattice.zeros())[0])


def driven(f):
    lattice = gx.Lattice(np.ones(3), (gx.Bond(SHIFT, gx.Linear(1.0)), gx.Drive(f)))
    return lambda: float(compiled(lattice))


CLOSED, SET_CLOSED = closed_over()
READS = {
    "global": (wave, set_global), "a function that it calls": (caller, set_global), "closure": (CLOSED, SET_CLOSED),
    "attribute": (of_settings, lambda x: setattr(SETTINGS, "size", x)),
    "class": (of_class, lambda x: setattr(Size, "size", x)),
    "array": (of_table, lambda x: TABLE.fill(x)),
    "partial": (functools.partial(lambda f, t: f(t), wave), set_global),
    "object": (SWING, lambda x: setattr(SWING, "size", x)), "object's global": (Swing(), set_global),
}


@pytest.mark.parametrize("f, change", READS.values(), ids=READS)
def test_what_a_waveform_reads_counts_as_it_stands(f, change):
    """A force that was compiled once follows the number, there and back."""
    run = driven(f)
    try:
        first = run()
        change(2.0)
        assert run() == pytest.approx(2 * first, rel=1e-12)
    finally:
        change(1.0)
    assert run() == first


class Spring(gx.Law):
    unit = 1.0

    def force(self, e):
        return self.unit * SIZE * e

    def energy(self, e):
        return self.unit * SIZE * e**2 / 2


@pytest.mark.study
def test_what_the_force_of_a_law_and_a_record_read_counts_as_it_stands():
    lattice = gx.Lattice(np.ones(3), gx.Bond(SHIFT, Spring()))
    state = gx.states.impact(lattice)
    record = {"peak": gx.Peak(lambda t, y, lattice: SIZE * y.v)}

    def run():
        found = gx.simulate(lattice, state, 0.4, step=0.1, record=record)
        return float(found.final.v[0]), float(found.recorded["peak"][0])

    first = run()
    try:
        set_global(2.0)
        softer = gx.Lattice(np.ones(3), gx.Bond(SHIFT, gx.Linear(2.0)))
        expected = gx.simulate(softer, state, 0.4, step=0.1).final.v[0]
        speed, peak = run()
    finally:
        set_global(1.0)
    assert speed == pytest.approx(float(expected), rel=1e-12) and peak == pytest.approx(2 * first[1], rel=1e-12)
    assert run() == first
    try:
        Spring.unit = 2.0
        assert run()[0] == pytest.approx(float(expected), rel=1e-12)
    finally:
        Spring.unit = 1.0
    assert run() == first


def test_nothing_is_compiled_again_where_nothing_changed():
    """What a function writes itself, such as a count of its calls, is not what it reads."""
    calls, numbers = [], {"size": 1.0, "list": [1, 2]}

    def counted(t):
        calls.append(t)
        return numbers["size"] * jnp.cos(t)

    run = driven(counted)
    run()
    once = len(calls)
    run()
    assert len(calls) == once
    numbers["size"] = 2.0
    run()
    assert len(calls) > once
    assert not gx.scenes.dimer(4)._outside.readers and Outside((counted,)).values() == Outside((counted,)).values()


COUNT, NOTES = {"n": 0}, types.SimpleNamespace(calls=0, size=1.0)


class Counted:
    def __init__(self):
        self.calls, self.log, self.size = 0, [], 1.0

    def __call__(self, t):
        self.calls += 1
        self.log.append(t)
        return self.size * t

    def method(self, t):
        self.calls += 1
        return self.size * t


def test_what_a_function_stores_into_is_not_what_it_reads():
    def counted(t):
        COUNT["n"] += 1
        NOTES.calls += 1
        NOTES.last = t
        return NOTES.size * t

    for function, holder in ((counted, NOTES), (one := Counted(), one), (one.method, one)):
        seen = Outside((function,))
        before = seen.values()
        function(1.0)
        assert seen.values() == before
        holder.size = 2.0
        assert seen.values() != before
        holder.size = 1.0
        assert seen.values() == before


def test_large_arrays_and_lists_are_known_by_a_digest():
    array, numbers = np.ones(10000), [1.0] * 10000
    seen = Outside((lambda t: array[0] * t, lambda t: numbers[0] * t))
    before = seen.values()
    assert len(repr(before)) < 2000 and seen.values() == before
    array[77] = 2.0
    between = seen.values()
    numbers[77] = 2.0
    assert len({before, between, seen.values()}) == 3


@pytest.mark.slow
def test_what_a_scene_reads_counts_in_a_fit():
    times = np.linspace(0.1, 2.0, 12)

    def scene(p):
        return gx.Lattice(SIZE * jnp.ones(3), gx.Bond(SHIFT, gx.Linear(p["k"])))

    start = gx.states.impact(scene({"k": 1.0}))
    run = gx.simulate(scene({"k": 1.0}), start, 2.0, save_at=times)
    traces = gx.Traces(times, velocity=np.asarray(run.vs)[:, :1], sites=[0], sigma=0.01)
    found = lambda: float(gx.fit(scene, {"k": 0.9}, traces, state=start).parameters["k"])
    assert found() == pytest.approx(1.0, rel=1e-6)
    try:
        set_global(2.0)  # twice the mass wants twice the stiffness
        assert found() == pytest.approx(2.0, rel=1e-6)
    finally:
        set_global(1.0)


@pytest.mark.slow
def test_what_objectives_and_residuals_read_counts_as_it_stands():
    found = (
        lambda: float(gx.design(goal, {"x": 3.0}).parameters["x"]),
        lambda: float(newton(left, [3.0]).x[0]),
        lambda: float(continuation(lambda x, p, args: left(x, args) * p, [3.0], 1.0, until=2.0).x[-1, 0]),
    )
    try:
        for size in (1.0, 2.0, 1.0):
            set_global(size)
            assert [f() for f in found] == pytest.approx([size] * 3, abs=1e-5)
    finally:
        set_global(1.0)


def goal(parameters):
    return (parameters["x"] - SIZE) ** 2


def left(x, args):
    return x - SIZE
