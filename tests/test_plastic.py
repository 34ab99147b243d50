"""Contacts that yield: restitution in closed form, energy to the last joule, derivatives, lanes, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

import granjax as gx

FREE = gx.Shift(1, "free")
WALLS = gx.Shift(1, "fixed")
REDUCED = 0.5


def struck(law, speed, t1, **how):
    lattice = gx.Lattice(1.0, gx.PlasticContact(FREE, law), sites=2)
    return gx.simulate(lattice, gx.states.impact(lattice, velocity=speed), t1, **how)


def restitution(run, speed):
    return (run.final.v[1] - run.final.v[0]) / speed


@pytest.mark.slow
def test_measures_along_a_run_know_what_it_had_in_memory():
    contacts = tuple(gx.PlasticContact(FREE, gx.WaltonBraun(k, 2.0)) for k in (1.0, 0.5))
    lattice = gx.Lattice(1.0, contacts, sites=2)
    run = gx.simulate(lattice, gx.states.impact(lattice, velocity=0.8), 9.0, save_at=12)
    assert [x["largest_overlap"].shape for x in run.by_term] == [(12, 1)] * 2
    energies = gx.measures.along(gx.measures.energy, lattice, run)
    assert np.abs(energies / energies[0] - 1).max() < 1e-9

    # the force that sites feel, and that of contacts
    def both(lattice, y, t):
        own = sum(c.force[0] for c in gx.measures.contacts(lattice, y, t))
        return lattice.force(t, y.u, y.v)[1], own

    pushes, forces = gx.measures.along(both, lattice, run)
    assert np.allclose(pushes, forces) and forces[-1] == 0 and run.memory["largest_overlap"][-1] > 0


@pytest.mark.slow
def test_restitution_of_walton_and_braun():
    for k1, k2 in ((1.0, 1.0), (0.7, 4.0)):
        run = struck(gx.WaltonBraun(k1, k2), 0.8, 9.0)
        assert abs(restitution(run, 0.8) - np.sqrt(k1 / k2)) < 1e-9
        assert run.energy_error < 1e-9 and run.contact_opened
        # half of the reduced mass's energy times 1 - e^2
        assert abs(run.lost[-1] - REDUCED / 2 * 0.64 * (1 - k1 / k2)) < 1e-10


@pytest.mark.slow
def test_restitution_of_thornton_and_its_derivative():
    y = 0.01

    def first(y):
        return jnp.sqrt(4 * y**2.5 / (5 * REDUCED))

    for ratio in (0.5, 1.2, 30.0):
        speed = float(ratio * first(y))
        run = struck(gx.Thornton(1.0, y), speed, 60 / np.sqrt(speed))
        wanted = gx.theory.restitution.thornton(speed, first(y))
        assert abs(restitution(run, speed) - wanted) < 1e-9 and run.energy_error < 1e-9
    assert gx.theory.restitution.thornton(0.5 * first(y), first(y)) == 1

    def simulated(y):
        return restitution(struck(gx.Thornton(1.0, y), 0.1, 100.0), 0.1)

    def closed(y):
        return gx.theory.restitution.thornton(0.1, first(y))

    got, wanted = (jax.jvp(f, (y,), (1.0,)) for f in (simulated, closed))
    assert np.allclose(got, wanted, rtol=1e-5)


@pytest.mark.parametrize(
    "law", [gx.WaltonBraun(1.0, 3.0), gx.Thornton(1.0, 0.1)], ids=["Walton-Braun", "Thornton"]
)
def test_energies_are_the_work_of_the_force(law):
    s = np.linspace(1e-3, 1.0, 7)
    # loading: all that is spent; unloading: all that comes back
    spent = jax.vmap(jax.grad(lambda s: law.stored(s, s) + law.lost(s)))(s)
    assert_allclose(spent, law.force(s, s), rtol=1e-12)
    back = jax.vmap(jax.grad(lambda s: law.stored(s, 1.0)))(s)
    assert np.allclose(back, law.force(s, 1.0), rtol=1e-12)
    assert np.all(np.diff(law.lost(s)) >= 0) and law.force(law.left(1.0), 1.0) == 0


def scene(overlap):
    """A precompressed chain with a dashpot and a push, whose contacts have yielded at other places by other lanes."""
    terms = (
        gx.PlasticContact(WALLS, gx.Thornton(np.linspace(1.0, 1.4, 6), 0.05), overlap),
        gx.Dashpot(WALLS, 0.03),
        gx.Drive(gx.Harmonic(0.05, 1.0), 2),
    )
    return gx.Lattice(1.0, terms, sites=5)


@pytest.mark.slow
def test_a_chain_keeps_its_balance_resumes_and_runs_in_lanes():
    overlaps = jnp.array([0.0, 0.02])
    batch = jax.vmap(scene, out_axes=-1)(overlaps)
    state = gx.State(batch.zeros(), batch.zeros().at[0].set(0.4))
    run = gx.simulate(batch, state, 4.0, save_at=4)
    assert np.max(run.energy_error) < 1e-9 and np.all(run.lost[-1] > 0) and np.all(run.work[-1])
    assert np.all(np.diff(run.memory["largest_overlap"], axis=0) >= 0)
    assert run.lost.shape == (4, 2) and run.memory["largest_overlap"].shape == (4, 6, 2)
    dims = run.to_xarray(lanes={"overlap": overlaps}).largest_overlap.dims
    assert dims == ("time", "bond", "overlap")
    start = gx.State(state.u[:, 1], state.v[:, 1])
    alone = gx.simulate(scene(0.02), start, 4.0, save_at=4)
    assert_allclose(run.us[..., 1], alone.us, rtol=0, atol=1e-8)
    assert_allclose(run.lost[:, 1], alone.lost, rtol=0, atol=1e-8)
    half = gx.simulate(scene(0.02), start, 2.0, save_at=4)
    on = gx.simulate(half.lattice, half.final, 4.0, t0=2.0, save_at=4)
    largest = np.abs(alone.final.u).max()
    assert_allclose(on.final.u, alone.final.u, rtol=0, atol=1e-7 * largest)


@pytest.mark.slow
def test_a_file_goes_on_only_with_its_largest_overlaps():
    law = gx.WaltonBraun(1.0, 4.0)

    def chain(largest):
        return gx.Lattice(1.0, gx.PlasticContact(FREE, law, largest=largest), sites=3, units="SI")

    start = gx.State(jnp.zeros(3), jnp.array([1.0, 0.0, -1.0]))
    run = gx.simulate(chain(0.0), start, 1.7, save_at=[0.0, 0.5, 1.7])
    data = run.to_xarray()
    with refused(r"data.largest_overlap: expected .* remembers .* got \[1. 1.\].*PlasticContact\("):
        gx.states.stored(chain(0.0), data)
    # in loading the largest overlap is the present one
    for frame in (0, 1):
        gx.states.stored(chain(0.0), data, frame)
    gx.states.stored(run.lattice, run.in_units("mm"))
    gx.states.stored(run.lattice, data.astype(np.float32).transpose("bond", "site", "time"))
    fixed = gx.PlasticContact(gx.Shift(1, "fixed"), law)
    with refused("data.largest_overlap: expected"):
        gx.states.stored(gx.Lattice(1.0, fixed, sites=3, units="SI"), data)
    resumed = chain(data.largest_overlap[-1].values)
    again = gx.simulate(resumed, gx.states.stored(resumed, data), 3.0, t0=1.7)
    # each of two contacts keeps a quarter of its energy
    assert_allclose(again.final.v, [-0.5, 0.0, 0.5], atol=1e-9)


class Sticking(gx.PlasticLaw):
    """A law of one's own: nothing comes back; F = k s in loading, none below."""

    stiffness: jax.Array

    def force(self, s, largest):
        return jnp.where((s >= largest) & (s > 0), self.stiffness * s, 0.0)

    def stored(self, s, largest):
        return 0.0 * (s + largest)

    def lost(self, largest):
        return self.stiffness * jnp.maximum(largest, 0) ** 2 / 2

    def left(self, largest):
        return largest


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["velocity", "force"])
def test_a_fit_of_plastic_contacts(kind):
    def scene(p):
        law = gx.WaltonBraun(p["loading"], 2 * p["loading"])
        return gx.Lattice(1.0, gx.PlasticContact(WALLS, law), sites=3)

    start = gx.State(jnp.zeros(3), jnp.array([1.0, 0.0, 0.0]))
    run = gx.simulate(scene({"loading": 1.2}), start, 6.0, save_at=31)
    s = -np.diff(run.us, axis=1, prepend=0, append=0)
    largest = run.memory["largest_overlap"]
    force = 2.4 * np.maximum(s - largest / 2, 0)
    data = {"velocity": run.vs, "force": (force[:, 1:] + force[:, :-1]) / 2}[kind]
    noise = 1e-3 * np.random.default_rng(0).normal(size=data.shape)
    seen = gx.Traces(run.ts, **{kind: data + noise}, sites=[0, 1, 2], sigma=1e-3)
    found = gx.fit(scene, {"loading": 1.0}, seen, state=start)
    deviation = found.deviations["loading"]
    assert abs(found.parameters["loading"] - 1.2) < 3 * deviation and deviation < 1e-3
    known = gx.information(scene, {"loading": 1.2}, seen, state=start)
    assert_allclose(known.matrix.sum(), deviation**-2, rtol=0.05)
    with refused("windows: expected 1 with"):
        gx.fit(scene, {"loading": 1.0}, seen, state=start, windows=2)
    with refused("method: expected .* that read the past"):
        gx.fit(scene, {"loading": 1.0}, seen, state=start, method="gradient")


@pytest.mark.slow
def test_a_law_of_ones_own():
    run = struck(Sticking(jnp.asarray(2.0)), 1.0, 5.0, tolerance=1e-6)
    assert abs(restitution(run, 1.0)) < 1e-4 and abs(run.lost[-1] - 0.25) < 1e-4


def test_what_needs_the_present_alone_refuses():
    chain = gx.Lattice(1.0, gx.PlasticContact(WALLS, gx.WaltonBraun(1.0, 2.0), 0.1), sites=4)
    modulated = gx.Modulated(chain.terms[0], gx.Harmonic(0.1, 1.0, mean=1.0))
    rest = gx.states.rest(chain)
    for call in (
        lambda: gx.Flow(4)(rest, 0.0, 1.0, chain),
        lambda: gx.linear.normal_modes(chain),
        lambda: gx.floquet.floquet(chain, rest, 1.0),
        lambda: gx.breathers.family(chain),
        lambda: gx.simulate(gx.Lattice(1.0, modulated, sites=4), rest, 1.0),
    ):
        with refused("remember|memory"):
            call()
    for name, value in (
        ("solver", gx.SRKN11b()),
        ("record", {"a": gx.Peak(lambda t, y, lattice: y.u)}),
        ("adjoint", gx.Reversible()),
        ("save_at", "steps"),
    ):
        with refused(name):
            gx.simulate(chain, rest, 1.0, **{name: value})
    with refused("unloading"):
        gx.WaltonBraun(2.0, 1.0)


@pytest.mark.slow
def test_reverse_mode_is_refused_in_a_sentence():
    speed = lambda k: struck(gx.Thornton(k, 0.01), 0.3, 0.5).final.v[0]
    with refused("expected forward mode .* got reverse mode"):
        jax.grad(speed)(1.0)
