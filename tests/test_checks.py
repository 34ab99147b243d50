import re
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

import granjax as gx
from granjax.base import checks
from granjax.continuation.newton import newton
from granjax.orbits.floquet import decide
from granjax.work_precision import measure

ROOT = Path(gx.__file__).parent
NAN = float("nan")
INF = float("inf")


def chain(*terms, mass=np.ones(6), **how):
    return gx.Lattice(mass, terms, **how)


HERTZ = gx.Hertz()
BOND = gx.Bond(gx.Shift(1, "free"), HERTZ)
LINEAR = gx.Lattice(np.ones(6), (gx.Bond(gx.Shift(1, "fixed"), gx.Linear(1.0)),))
LOADED = gx.Lattice(np.ones(6), (gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(1.0, 0.3)),))
EMPTY = jax.vmap(lambda m: gx.Lattice(m, LINEAR.terms, sites=6), out_axes=-1)(np.ones(0))
MASKED = np.ma.array(np.ones(6), mask=[False] * 5 + [True])
CELL = {"bead": np.ones(6), "resonator": np.ones(6)}


def driven(omega):
    return gx.driven.driven_chain(LOADED, 0.01, omega, damping=0.1)


# what is wrong, who refuses it, and what the sentence must name
BAD = (
    *((f"mass {m}", lambda m=m: chain(BOND, mass=m, sites=6), "mass") for m in (0.0, NAN)),
    (
        "mass of a field",
        lambda: chain(mass={"bead": np.ones(3), "resonator": -np.ones(3)}),
        "mass['resonator']",
    ),
    ("mass complex", lambda: chain(BOND, mass=np.ones(6) * 1j), "mass"),
    ("mass without sites", lambda: chain(BOND, mass=1.0), "mass"),
    ("one site", lambda: chain(mass=np.ones(1)), "two sites"),
    ("sites 0", lambda: chain(mass=1.0, sites=0), "sites"),
    ("sites and masses", lambda: chain(mass=np.ones(5), sites=6), "mass"),
    *((f"hertz {a}", lambda a=a: gx.Hertz(a), "stiffness") for a in (0, 1j, "stiff")),
    *((f"F0 {f}", lambda f=f: gx.Hertz(1.0, f), "precompression") for f in (-1.0, INF)),
    *((f"p {p}", lambda p=p: gx.PowerLaw(1.0, p, 1.0), "exponent") for p in (0, [0.5, 0.0])),
    ("p of two signs", lambda: gx.PowerLaw(1.0, np.array([1.5, -3]), 1.0), "exponent"),
    (
        "magnets without load",
        lambda: gx.PowerLaw(1.0, -3.0, np.array([1.0, 0.0])),
        "exponent and precompression",
    ),
    ("polynomial of nothing", lambda: gx.Polynomial(0.0), "K2, K3, K4"),
    *((f"offset {k}", lambda k=k: gx.Shift(k), "offset") for k in (0, 1.0)),
    ("pairs float", lambda: gx.Pairs([0.0], [1]), "tail"),
    ("pairs lengths", lambda: gx.Pairs([0, 1], [1]), "head"),
    ("pairs self", lambda: gx.Pairs([0, 1], [1, 1]), "head"),
    (
        "pairs of another lattice",
        lambda: chain(gx.Bond(gx.Pairs([0], [1]), HERTZ)),
        "terms[0] (Bond)",
    ),
    ("vector zero", lambda: gx.Stretch(gx.Shift(1), [0.0, 0.0]), "vector"),
    ("damping", lambda: gx.Damping(-0.1), "rate"),
    *(
        (
            f"drive of site {k}",
            lambda k=k: chain(gx.Drive(gx.Harmonic(1.0, 1.0), k)),
            "terms[0] (Drive)",
        )
        for k in (6, -7)
    ),
    ("a lattice beyond memory", lambda: chain(BOND, mass=1.0, sites=10**14), "GB of memory"),
    (
        "linearised about another shape",
        lambda: gx.lattice.linearised(LINEAR, 0.0, np.zeros(5)),
        "u",
    ),
    ("wall side", lambda: gx.Wall(HERTZ, "rigth"), "Did you mean 'right'?"),
    ("no term", lambda: chain(BOND, HERTZ), "terms[1]"),
    (
        "parameters per bond",
        lambda: chain(gx.Damping(0.1), gx.Bond(gx.Shift(1, "fixed"), gx.Hertz(np.ones(6)))),
        "terms[1] (Bond)",
    ),
    ("temperatures per site", lambda: chain(gx.Langevin(0.1, np.ones(5))), "terms[0] (Langevin)"),
    ("rates per site", lambda: chain(gx.Damping(np.ones(5))), "terms[0] (Damping)"),
    (
        "modulation per bond",
        lambda: chain(gx.Modulated(BOND, lambda t: jnp.ones(4))),
        "terms[0] (Modulated)",
    ),
    (
        "offset beyond the chain",
        lambda: chain(gx.Bond(gx.Shift(9, "free"), HERTZ)),
        "terms[0] (Bond)",
    ),
    (
        "vector in another space",
        lambda: chain(gx.Bond(gx.Stretch(gx.Shift(1), [1.0, 0, 0]), HERTZ), dimension=2),
        "terms[0] (Bond)",
    ),
    ("unknown field", lambda: chain(gx.OnSite(HERTZ, "beed"), mass=CELL), "bead"),
    ("no field in a cell", lambda: chain(BOND, mass=CELL), "terms[0] (Bond)"),
    ("mass masked", lambda: chain(BOND, mass=MASKED), "1 of 6 masked"),
    ("data masked", lambda: gx.Traces(np.arange(6.0), velocity=MASKED, sites=0), ".filled(np.nan)"),
    (
        "times complex",
        lambda: gx.simulate(
            chain(BOND), gx.states.impact(chain(BOND)), 1.0, save_at=np.linspace(0, 1, 3) * (1 + 0j)
        ),
        "save_at",
    ),
    (
        "a displacement per site",
        lambda: gx.states.random(chain(BOND), 0, np.ones(6)),
        "displacement",
    ),
    (
        "a speed per site",
        lambda: gx.states.velocity_step(chain(BOND), np.ones(6)),
        "c: expected one number",
    ),
    *(
        (
            f"{what} of another length",
            lambda f=f: f(LINEAR, np.zeros(7)),
            "shape (6,), that of the lattice",
        )
        for what, f in (
            ("force", lambda l, x: l.force(0.0, x, x)),
            ("energy", lambda l, x: l.energy(0.0, x, x)),
            ("acceleration", lambda l, x: l.acceleration(0.0, x, x)),
            ("flow", lambda l, x: gx.Flow(2)((x, x), 0.0, 1.0, l)),
        )
    ),
    (
        "force of an array for fields",
        lambda: chain(mass=CELL).force(0.0, np.zeros(6), np.zeros(6)),
        "'bead': (6,)",
    ),
    *(
        (f"tolerance {x}", lambda x=x: checks.tolerance("tolerance", x), "tolerance")
        for x in (-1, True, NAN, 1.0, np.ones(2))
    ),
    *(
        (
            f"{name} of a growth rate",
            lambda i=i: gx.theory.nls.growth_rate(*(NAN if j == i else 1.0 for j in range(4))),
            name,
        )
        for i, name in enumerate(("Q", "amplitude", "nu2", "nu3"))
    ),
    *(
        (
            f"{name} of a sweep",
            lambda name=name: gx.driven.response(driven, [0.8, 0.9], 6.0, **{name: 0.0}),
            name,
        )
        for name in ("accuracy", "tolerance", "jump")
    ),
    (
        "resolution",
        lambda: decide(np.ones(2), np.zeros(2), 0, True, 1.0),
        "resolution",
    ),
    (
        "masses of other sites",
        lambda: gx.identify.regression(
            np.ones(3), {"a": gx.Damping}, np.arange(3.0), np.ones((3, 2)), np.ones((3, 2))
        ),
        "mass and us",
    ),
    (
        "damping of other sites",
        lambda: gx.driven.driven_chain(LINEAR, 0.1, 1.0, damping=np.ones(5)),
        "(Damping)",
    ),
    (
        "complex displacements",
        lambda: LINEAR.force(0.0, np.ones(6) * 1j, np.zeros(6)),
        "u: expected real numbers",
    ),
    (
        "a state of other sites",
        lambda: gx.floquet.multipliers(
            gx.Flow(2), gx.State(np.zeros(7), np.zeros(7)), 0.0, 1.0, LINEAR
        ),
        "y.u: expected shape (6,)",
    ),
    (
        "a frequency on the wrong side",
        lambda: gx.theory.nls.bright_profile(
            gx.theory.nls.coefficients(1.0, 1.5, 0.375, 1.0, np.pi), 2.0, 9
        ),
        "omega: expected a frequency above",
    ),
    (
        "too few periods",
        lambda: gx.chaos.lyapunov(LINEAR, gx.states.impact(LINEAR), 1.0, periods=9),
        "periods",
    ),
)


@pytest.mark.parametrize(
    "make, named",
    [
        (lambda y: gx.simulate(LINEAR, y, 1.0, save_at=9000), "save_at"),
        (lambda y: gx.simulate(LINEAR, y, 1.0, save_at=np.linspace(0, 1, 10**4)), "save_at"),
        (lambda y: gx.simulate(LINEAR, y, 1.0, step=1e-4, save_at="steps"), "save_at"),
        (
            lambda y: gx.simulate(LINEAR, y, 1.0, tolerance=1e-6, save_at="steps", max_steps=10**4),
            "max_steps",
        ),
    ],
)
def test_frames_are_counted_with_the_size_of_the_state(make, named, monkeypatch):
    """Six sites, 104 bytes a frame, in a computer of 900 kB."""
    state = gx.State(jnp.zeros(6), jnp.zeros(6))
    monkeypatch.setattr(checks.os, "sysconf", lambda name: 900)
    with refused(f"^{named}: expected at most .* of such a state, which .* of memory hold"):
        make(state)


@pytest.mark.parametrize("make, named", [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_bad_input_is_refused_in_our_words(make, named):
    """ValueError with argument, expected and got, raised in granjax and not inside JAX, and printed by itself."""
    with pytest.raises(ValueError) as caught:
        make()
    assert re.match(r"(?s).+: expected .+, got .+\.", str(caught.value))
    assert named in str(caught.value)
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    frame = caught.value.__traceback__
    while frame.tb_next is not None:
        frame = frame.tb_next
    assert Path(frame.tb_frame.f_code.co_filename).is_relative_to(ROOT)


class Branching(gx.Law):
    """A law that branches on its strain, or only raises."""

    raises: bool = False

    def force(self, e):
        if self.raises:
            raise ValueError
        return e if e > 0 else 0 * e

    def energy(self, e):
        return e**2 / 2


class WithNumPy(gx.Law):
    def force(self, e):
        return np.sinh(e)

    def energy(self, e):
        return np.cosh(e) - 1


def test_a_law_that_branches_on_its_strain_is_told_of_where():
    for raises, said in ((False, r"truth value.*write jnp\.where\(e > 0"), (True, "an error: ")):
        with refused(said):
            chain(gx.Bond(gx.Shift(1, "fixed"), Branching(raises)))
    with refused(r"traced array with shape float64\[.*\]\. JAX traces a force: write it with jax"):
        chain(gx.Bond(gx.Shift(1, "fixed"), WithNumPy()))


def test_sentences():
    with refused(r"^stiffness: expected numbers above zero, got -1\.0\. The contact"):
        gx.Hertz(-1.0)
    with refused(r"^boundary: expected one of 'fixed', 'free', .*, got 'fre'\. Did you"):
        gx.Shift(1, "fre")
    with refused(r"^x: expected numbers in \(0, 1\], got 0\.0\. Why$"):
        checks.within("x", 0.0, 0, 1, open_low=True, remedy="Why")


def test_bounds_belong_or_not():
    assert float(checks.within("x", 1.0, 0, 1)) == 1.0
    with refused(r"\[0, 1\)"):
        checks.within("x", 1.0, 0, 1, open_high=True)
    assert float(checks.non_negative("x", 0)) == 0.0
    assert checks.whole("n", np.int64(3), 3) == 3
    for bad in (2, 3.0, True, "3"):
        with refused("whole number not below 3"):
            checks.whole("n", bad, 3)


def test_parameters_take_the_default_float_and_keep_a_given_one():
    assert checks.parameter("x", 1).dtype == jnp.float64
    assert checks.parameter("x", np.float32(1)).dtype == jnp.float64
    assert checks.parameter("x", jnp.float32(1)).dtype == jnp.float32
    assert checks.parameter("x", jnp.arange(3)).dtype == jnp.float64


def test_what_is_legal_passes():
    """An empty mask hides nothing; NaN marks what is missing in data; lanes, fields and tangents behind the sites."""
    assert checks.real("x", np.ma.array([1.0, 2.0])).tolist() == [1.0, 2.0]
    assert np.isnan(checks.real("x", [1, NAN])).tolist() == [False, True]
    assert checks.real("x", jnp.arange(2)).dtype == np.float64
    assert checks.tolerance("tolerance", np.float32(1e-6)) == pytest.approx(1e-6)
    assert (
        checks.per_lane("x", [1.0, 2.0], (2,)).shape == (2,)
        and checks.per_lane("x", 1, (2,)).shape == ()
    )
    assert LINEAR.force(0.0, np.zeros((6, 3)), np.zeros((6, 3))).shape == (6, 3)
    lanes = jax.vmap(
        lambda k: gx.Lattice(np.ones(6), (gx.Bond(gx.Shift(1), gx.Linear(k)),)), out_axes=-1
    )(jnp.ones(2))
    assert gx.states.random(lanes, 0, np.array([0.0, 1.0])).u[:, 0].tolist() == [0.0] * 6
    assert np.isnan(jax.jit(gx.theory.nls.growth_rate)(1.0, 1.0, NAN, 1.0))


def test_traced_values_pass_the_checks():
    got = jax.jit(lambda A, F0: gx.Hertz(A, F0).force(0.5))(2.0, 0.0)
    np.testing.assert_allclose(got, 2 * 0.5**1.5, rtol=1e-15)
    slope = jax.grad(lambda m: gx.Lattice(m * np.ones(3), (BOND,)).kinetic_energy(jnp.ones(3)))(2.0)
    assert float(slope) == 1.5


@pytest.mark.parametrize(
    "measured",
    [
        lambda chain: gx.linear.normal_modes(chain).omega[0],
        lambda chain: gx.simulate(chain, gx.states.impact(LOADED, 0.1), 1.0, step=0.1).us[-1][0],
    ],
    ids=["normal_modes", "simulate"],
)
def test_a_plain_number_is_differentiated_like_an_array(measured):
    """JAX 0.10.2 makes its stopped derivative a number without a shape."""

    def of_mass(m):
        return measured(gx.Lattice(m, LOADED.terms, sites=6))

    by_array = jax.grad(of_mass)(jnp.array(1.0))
    np.testing.assert_allclose(jax.grad(of_mass)(1.0), by_array, rtol=1e-12)


def test_every_tolerance_that_asks_for_nothing_is_refused():
    """One place says what a tolerance is; orbits, multipliers and settling ask it."""
    chain = gx.scenes.monomer(3, precompression=1.0)
    driven = gx.driven.driven_chain(chain, 0.01, 2.0, damping=0.1)
    rest = gx.states.rest(chain)
    uses = (
        lambda x: gx.forced.forced_orbit(driven, np.pi, tolerance=x),
        lambda x: gx.driven.settle(driven, rest, np.pi, tolerance=x),
        lambda x: gx.floquet.floquet(chain, rest, 1.0, tolerance=x),
        lambda x: gx.design(lambda p: p["x"] ** 2, {"x": 1.0}, tolerance=x),
    )
    for use in uses:
        with refused("^tolerance: expected"):
            use(1.0)


CRYSTAL = gx.scenes.triangular(6, 6)
CELLS = gx.scenes.monomer(8, precompression=1.0, boundary="periodic")


@pytest.mark.parametrize(
    "said, call",
    [
        ("axis: expected .* -1 ... 0, got 2", lambda: gx.measures.participation(np.ones(3), 2)),
        ("branches: expected numbers", lambda: gx.scenes.junction(4, 3)),
        ("angles: expected 2, one per", lambda: gx.scenes.junction(4, [3, 3], angles=0.3)),
        ("mass: expected shape .10,.", lambda: gx.scenes.junction(4, [3, 3], mass=np.ones(4))),
        ("at: expected a sequence", lambda: gx.scenes.mass_with_mass(5, at=2)),
        ("masses: expected one entry per", lambda: gx.scenes.woodpile(5, 0.5, 1.0)),
        (
            "direction: expected a vector of 2 numbers",
            lambda: gx.measures.front_decay(CRYSTAL, np.ones((6, 6)), (0, 0), direction=[1, 2, 3]),
        ),
        ("modes: expected two", lambda: gx.orbits.torus(LINEAR, (0, 1, 2), (0.1, 0.1))),
        ("amplitudes: expected two", lambda: gx.orbits.torus(LINEAR, (0, 1), 0.1)),
        (
            "omega: expected one number, got shape",
            lambda: gx.first_order.soliton(gx.first_order.DNLS(20), [-1.0]),
        ),
        ("first: expected a wave, got 1", lambda: gx.travelling.collide(1, 2)),
        ("wave: expected a wave, got 1", lambda: gx.travelling.reflect(1)),
        ("ladders: expected one", lambda: measure([], np.ones(2))),
        (
            "sites: expected a ring, or at most 512",
            lambda: gx.first_order.DNLS(513, boundary="free").drift(np.ones(513) + 0j, 1.0),
        ),
        (
            "lattice: expected one lane or more, got lanes of shape .0,.",
            lambda: gx.simulate(EMPTY, gx.states.rest(EMPTY), 1.0),
        ),
        (
            "threshold: expected a number, or .* shape .6,., got shape .3,.",
            lambda: gx.simulate(
                LINEAR,
                gx.states.impact(LINEAR),
                1.0,
                record={"late": gx.Arrival(lambda t, y, lattice: y.v, np.ones(3))},
            ),
        ),
        (
            "lattice: expected a lattice of known numbers",
            lambda: jax.grad(
                lambda m: gx.linear.density_of_states(
                    gx.Lattice(m, CELLS.terms, sites=8), 20, 32
                ).density[0]
            )(1.0),
        ),
        (
            "lattice and omega: expected known numbers",
            lambda: jax.grad(lambda w: gx.linear.complex_bands(CELLS, w).k[0, 0].imag)(3.0),
        ),
    ],
)
def test_what_does_not_fit_ends_in_a_sentence(said, call):
    with refused(said):
        call()


def unfinished(what, throw):
    """Something that does not come to its end."""
    well = gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)), gx.Damping(0.1)
    pair = lambda p: gx.Lattice(1.0, (*well, gx.Drive(gx.Harmonic(p["force"], 1.0), 0)), sites=2)
    how = {"max_steps": 1, "throw": throw}
    if what == "newton":
        return newton(lambda x, a: x**2 + 1, [0.5], **how)
    if what == "orbit":
        return gx.forced.forced_orbit(pair({"force": 1.0}), 2 * np.pi, steps=24, **how)
    if what == "fit":
        traces = gx.Traces(np.arange(9.0), displacement=np.sin(np.arange(9.0)), sites=0)
        return gx.fit(pair, {"force": 30.0}, traces, state=(np.zeros(2), np.zeros(2)), **how)
    if what == "design":
        return gx.design(lambda p: jnp.sqrt(p["x"] - 2), {"x": 1.0}, **how)
    if what == "equilibrium":
        return gx.equilibrium(gx.scenes.monomer(3), loads=np.full(3, 0.1), **how)
    toda = gx.scenes.toda(4)
    return gx.simulate(toda, gx.states.impact(toda), 9.0, tolerance=1e-6, **how)


@pytest.mark.slow
@pytest.mark.skipif("typed" in sys.modules, reason="the annotations say booleans")
@pytest.mark.parametrize("what", ["newton", "orbit", "fit", "design", "equilibrium", "run"])
def test_numbers_say_whether_to_throw_as_booleans_do(what):
    with pytest.raises(RuntimeError) as error:
        unfinished(what, 1)
    assert unfinished(what, 0).outcome in str(error.value)
