"""The entry of public functions: what is of the wrong kind meets a sentence before anything is computed."""

import functools
import inspect
import pickle
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float
from test_vocabulary import NAMES, public

import granjax as gx
from granjax import types as words
from granjax.checks import described
from granjax.entry import checked, kind_of, takes
from granjax.results import Result

LATTICE = gx.scenes.monomer(4, precompression=1.0)
STATE = gx.states.rest(LATTICE)
MASKED = np.ma.array([1.0, 2.0], mask=[False, True])


class Odd:
    def __repr__(self):
        raise RuntimeError("no text")

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("no array")


# what is no real number, in any shape
NONE = (None, True, "1", b"1", 1j, object(), Odd(), {1}, {"a": 1}, [1, [2]], [1, "a"], [None], [True], (x for x in ()),
        np.array([1, None]), np.array(["a"]), np.ones(2) * 1j, np.ones(2, bool), MASKED, [MASKED], 10**400, 2**63,
        jax.random.key(0), gx, float, LATTICE, np.datetime64("2020"), Ellipsis, bytearray(b"1"))
MANY = ([1.0], (1, 2), np.ones(3), jnp.ones((2, 2)), range(3), [np.ones(2)] * 3, np.ones(0))
ONE = (1, 1.0, np.float32(1), np.int64(1), np.array(1.0), jnp.float32(1), jnp.asarray(2), np.ma.array(1.0))

class Series:
    """As of pandas: no sequence, and read by NumPy."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype)

    def __iter__(self):
        return iter(self.values)



class Named(NamedTuple):
    """Looked at where it is taken, as JAX makes it anew of anything."""

    name: str
    size: words.Scalar = 1.0
    more: object = None


# an annotation, what fits it, what does not
KINDS = (
    (words.Scalar, ONE, NONE + MANY),
    (words.Number, (*ONE, np.ones(3), jnp.ones((2, 2))), (*NONE, [1.0], (1, 2))),
    (words.Parameter, ONE + MANY, NONE),
    (float, ONE, NONE + MANY),
    (words.Count, (0, -3, np.int8(2)), (*NONE, *MANY, 1.0, np.array(1), jnp.asarray(1))),
    (bool, (True, np.bool_(False)), (None, 0, 1.0, "yes", np.ones(2, bool))),
    (words.Flags, (True, np.ones(2, bool)), (None, 0, np.ones(2))),
    (str, ("", np.str_("a")), (None, 1, b"a", ["a"])),
    (words.Numbers, (np.ones(2), jnp.ones(()), np.arange(2)), (*NONE, [1.0], 1.0)),
    (words.Times, (np.ones(2),), (*NONE, [1.0], np.ones((2, 2)))),
    (words.Displacements, (np.ones(2), np.ones(2) * 1j, {"u": jnp.ones(2)}), (None, 1.0, {}, {"u": None}, MASKED)),
    (words.StateLike, (STATE, (np.ones(2), jnp.ones(2)), [{"u": np.ones(2)}] * 2),
     (None, 1, (), (1.0, 2.0), (np.ones(2),), (np.ones(2),) * 3, (np.ones(2), None), (MASKED, MASKED), "ab",
      (np.ones(2), [1, 2]), (range(2), range(2)), (np.ones(()), np.ones(())), ({"u": [1.0]}, {"u": [1.0]}),
      (np.ones(2) * 1j, np.ones(2)))),
    (words.Site, (0, -1, (1, 2), [0]), (None, True, 1.0, (1, 0.5), "a", np.ones(2))),
    (words.Cell, (1, (2, 2), None), (1.5, "a", (1.5,))),
    (words.Values, ([1], (1,), range(2), np.ones(2), jnp.ones(2), np.array(["a"]), np.array(["a"], object),
                    Series([1])),
     (None, 1, 1.0, "a", b"a", {1}, np.array([1, None]), np.array(1.0), MASKED, Odd(), np.ndarray, Series([None]))),
    (words.Seed, (1, jax.random.key(0), jnp.uint32(3)), (None, 1.0, "a", np.ones(2), jnp.ones(2))),
    (words.Quantity, (gx.measures.energy, lambda *x: x), (None, 1, "len", len, lambda t: t)),
    (Callable[..., Any], (len, lambda t: t, gx.Hertz), (None, 1, "len")),
    (words.Pytree, (1.0, STATE, {"a": np.ones(2)}), (None, "a", {}, (np.ones(2), "b"), object())),
    (str | Path, ("a", Path("a")), (None, 1, ["a"])),
    (str | Sequence[str], ("a", ["a"], ()), (None, 1, [1])),
    (Sequence[str], (["a"], ("a", "b")), ("a", {"a"}, None, 1)),
    (dict[str, words.Parameter] | None, (None, {}, {"a": [1.0]}), (1, {"a": "b"}, {1: 1.0}, [("a", 1)])),
    (Mapping[str, Any], ({}, {"a": None}), (None, {1: 2})),
    (tuple[str, int], (("a", 1),), (("a",), ("a", 1.0), ["a", 1], None)),
    (tuple[int, ...], ((), (1, 2)), ((1.0,), [1], 1)),
    (Literal["a", "b"], ("a",), ("c", 1, None, np.ones(2))),
    (Callable | words.Scalar, (len, 1.0), (None, "a", np.ones(2))),
    (Float[np.ndarray, "n n"], (np.eye(2), jnp.eye(2)), (np.ones(2), [[1.0]], None, np.eye(2) * 1j)),
    (gx.Lattice | gx.Flow, (LATTICE, gx.Flow(3)), (None, gx.Lattice, STATE, 1)),
    (gx.Law, (gx.Hertz(),), (None, 1.0, gx.Hertz)),
    (Named, (Named("a"), Named("a", 2, "b")), (None, "a", ("a", 1.0), Named(1), Named("a", "b"), Named(None), Named)),
    (Any, (None, 1, object()), ()),
)


def example(annotation):
    def function(given, *, also=None):
        return given

    function.__annotations__ = {"given": annotation, "also": annotation}
    return checked(function)


@pytest.mark.parametrize("annotation, good, bad", KINDS, ids=[str(k[0])[:40] for k in KINDS])
def test_what_is_of_a_kind_and_what_is_not(annotation, good, bad):
    function = example(annotation)
    for x in good:
        assert function(x) is x and function(x, also=x) is x and function(given=x) is x
    for x in bad:
        for call in (lambda x=x: function(x), lambda x=x: function(given=x)):
            with pytest.raises(ValueError, match=r"(?s)^(a name in )?given.*: expected .+, got .+\."):
                call()


SENTENCES = (
    (words.Scalar, np.ones(3), "given: expected one number, got an array of float64, shape (3,). For many at once"),
    (words.Scalar, 10**5000, "given: expected one number, got a whole number of 5000 digits. A whole number has 64"),
    (words.Parameter, np.ones(2) * 1j, "got an array of complex128, shape (2,). Take .real or abs()"),
    (words.Parameter, MASKED, "given: expected numbers without a mask, got 1 of 2 masked. "),
    (words.StateLike, (np.ones(2), None), "given.v: expected an array of real numbers over the sites"),
    (Named, Named("a", "b"), "given.size: expected one number, got 'b'."),
    (Sequence[Named], [Named("a", "b")], "given[0].size: expected one number, got 'b'."),
    (dict[str, words.Scalar], {"a": "b"}, "given['a']: expected one number, got 'b'."),
    (Sequence[str], ["a", 1], "given[1]: expected a string, got 1."),
    (gx.Lattice, gx.Lattice, "given: expected a Lattice, such as gx.scenes.monomer(100), got the class Lattice."),
    (words.Count | None, 2.5, "given: expected a whole number or None, got 2.5."),
)


@pytest.mark.parametrize("annotation, x, said", SENTENCES, ids=[said[:30] for *_, said in SENTENCES])
def test_sentences(annotation, x, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        example(annotation)(x)


def test_what_is_traced_passes_where_an_array_is_meant():
    number, count = example(words.Scalar), example(words.Count)
    assert jax.jit(number)(2.0) == 2.0 and jax.vmap(number)(jnp.ones(3)).shape == (3,)
    with pytest.raises(ValueError, match="expected a whole number, got a traced value .* known before tracing"):
        jax.jit(count)(2)
    with pytest.raises(ValueError, match="expected one number, got a traced value"):
        jax.jit(number)(jnp.ones(2))


def test_a_value_that_must_be_known_is_named():
    for function in (lambda x: float(x), lambda x: np.asarray(x), lambda x: 1 if x > 0 else 2):
        with pytest.raises(ValueError, match="x: expected what is known before tracing, got a traced value"):
            jax.jit(checked(function))(1.0)
    with pytest.raises(jax.errors.ConcretizationTypeError):
        jax.jit(lambda y: checked(lambda x: float(y))(1.0))(2.0)


def test_functions_are_asked_for_their_arguments():
    class Object:
        def __call__(self, a, b):
            pass

        def method(self, a, b):
            pass

    functions = (
        lambda a, b: 0, lambda a, b=1: 0, lambda *a: 0, lambda a, *, b: 0, lambda a, *, b=1: 0, lambda a, /, b: 0,
        lambda **a: 0, Object(), Object().method, Object, functools.partial(lambda a, b: 0, 1), gx.measures.energy,
        jax.jit(lambda a, b: 0), checked(lambda a, b: 0), gx.Hertz, gx.Hertz(1.0).force, gx.Flow(2).tangents, len,
    )
    for function in functions:
        for count in range(5):
            try:
                inspect.signature(function).bind(*range(count))
                fits = True
            except TypeError:
                fits = False
            assert takes(function, count) == fits, (function, count)
    assert takes(lambda a, *, b: 0, 1, ["b"]) and not takes(lambda a, *, b: 0, 1, ["c"])


def test_a_first_call_in_two_threads(monkeypatch):
    function, both = checked(lambda a, b: a), threading.Barrier(2)
    function.__wrapped__.__annotations__ = {"a": words.Scalar, "b": str}
    kind = kind_of

    def together(hint):
        both.wait(60)
        return kind(hint)

    monkeypatch.setattr(sys.modules["granjax.entry.checked"], "kind_of", together)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(lambda i: function(i, "b"), range(2))) == [0, 1]
    assert function(1.0, "b") == 1.0
    with pytest.raises(ValueError, match="^b: expected a string"):
        function(1.0, 2.0)


@checked
def module_level(lattice: gx.Lattice, steps: words.Count = 3, *, name: str = "a", **options: Any) -> int:
    """Said."""
    return steps


class Sized(eqx.Module):
    size: words.Scalar

    @checked
    def __init__(self, size: words.Scalar):
        self.size = size


class Own(Sized):
    def __init__(self, text):
        super().__init__(len(text))


@checked
class Plain(eqx.Module):
    size: words.Scalar = 1.0


def asks(function):
    """A function of the user's that asks for the value of what it is given."""
    return lambda x, *others: function(x if not isinstance(x, dict) else x["k"])


class Asking(gx.Law):
    stiffness: jax.Array

    def force(self, e):
        return self.stiffness * e

    def energy(self, e):
        return self.stiffness * e**2 / 2

    def overlap(self, e):
        return e if float(self.stiffness) > 0 else -e


def test_a_function_that_asks_for_a_value_is_named():
    """And the argument that is traced only where granjax itself asks for it."""
    said = ": expected a function that JAX can trace, got one that asks for a known value in line .* of test_entry.py"
    x = np.ones(1)
    asked = np.sin, lambda x: float(x.sum()), lambda x: 1 if x.sum() > 0 else 2, lambda x: (1, 2)[x.sum().astype(int)]
    for function in map(asks, asked):
        with pytest.raises(ValueError, match="^residual" + said):
            gx.newton.newton(function, x)
        with pytest.raises(ValueError, match="^objective" + said):
            gx.design(function, {"k": 1.0})
    with pytest.raises(ValueError, match="^field" + said):
        gx.Flow(2, diffrax.Euler(), lambda t, y, args: np.sin(y))(x, 0.0, 1.0, None)
    lattice = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), Asking(jnp.asarray(1.0))), sites=4)
    with pytest.raises(jax.errors.ConcretizationTypeError):
        jax.jit(gx.measures.overlap)(lattice, STATE)


def test_a_checked_function_stays_what_it_was():
    assert module_level.__doc__ == "Said." and list(inspect.signature(module_level).parameters)[1] == "steps"
    assert pickle.loads(pickle.dumps(module_level)) is module_level and pickle.loads(pickle.dumps(Plain(2.0))).size == 2
    for wrong in (lambda: module_level(), lambda: module_level(LATTICE, 1, 2)):
        with pytest.raises(TypeError, match="argument"):
            wrong()
    assert module_level(LATTICE, any_other=3) == 3


MISSPELT = {
    "a function": (lambda: gx.simulate(LATTICE, STATE, 1.0, tolerence=1e-9), "simulate", "Did you mean 'tolerance'"),
    "a class": (lambda: gx.Hertz(stifness=2.0), "Hertz", "Did you mean 'stiffness'"),
    "a class whose names are far": (lambda: gx.Hertz(A=2.0), "Hertz", "Its keywords are stiffness, precompression"),
    "a scene": (lambda: gx.scenes.beads("steel", 5, preload=10.0), "beads", "precompression"),
    "a term": (lambda: gx.Damping(rates=0.1), "Damping", "Did you mean 'rate'"),
    "a lattice": (lambda: gx.Lattice(1.0, (), size=3), "Lattice", "Did you mean 'sites'"),
    "a record": (lambda: gx.Peak(quantiy=None), "Peak", "Did you mean 'quantity'"),
    "a picture": (lambda: gx.plots.branch(None, ax=None), "branch", "Did you mean 'axes'"),
    "an orbit": (lambda: gx.breathers.breather(LATTICE, 1.0, gues=None), "breather", "Did you mean 'guess'"),
    "a fit": (lambda: gx.fit(None, {}, (), state=STATE, bound={}), "fit", "Did you mean 'bounds'"),
    "a sweep": (lambda: gx.sweep(None, {}, stores="x"), "sweep", "Did you mean 'store'"),
    "a method": (lambda: gx.Fit.whiteness(None, lag=3), "whiteness", "Did you mean 'lags'"),
}


@pytest.mark.parametrize("misspelt", MISSPELT)
def test_a_misspelt_keyword_meets_the_nearest_one(misspelt):
    call, name, remedy = MISSPELT[misspelt]
    with pytest.raises(TypeError, match=f"{name}.* got an unexpected keyword argument .*{remedy}"):
        call()


def test_no_signature_takes_keywords_that_mean_nothing():
    found = [name for name in gx.__all__ if callable(getattr(gx, name)) and not isinstance(getattr(gx, name), type)
             and "misspelt" in inspect.signature(getattr(gx, name)).parameters]
    assert found == []


def test_classes_check_what_they_are_made_of_and_nothing_that_jax_rebuilds():
    for kind in (Sized, Plain):
        with pytest.raises(ValueError, match="size: expected one number"):
            kind("large")
        assert jax.tree.map(lambda x: "anything", kind(1.0)).size == "anything"
    assert Own("four").size == 4
    with pytest.raises(ValueError, match="unexpected|size"):
        Sized(None)


def test_what_was_given_is_said_in_few_words():
    class Long(list):
        pass

    for x in (Odd(), [Odd()], {"a": Odd()}, [10**6000], Long(range(10**5)), "a" * 10**6, {i: i for i in range(10**4)}):
        assert len(described(x)) < 200
    assert described(None) == "None" and described(np.ones((2, 3))) == "an array of float64, shape (2, 3)"


def test_an_annotation_that_says_nothing_lets_everything_through():
    assert all(kind_of(hint) is None for hint in (Any, object, "later", words.Count | Any))


# inside of the library, called by the command line or before JAX is there, and what refuses itself
INSIDE = {"checks", "cli", "descent", "entry", "files", "outside", "printing", "programs",
          "split_system", "tuning", "variables",
          "sweeps", "flow.batching", "flow.method"}
# classes that only the library makes
MADE = {"Function", "InUnits", "Motion", "Problem", "Points", "Reach", "Reached", "Riemann", "Scene",
        "Shooting", "Sweep", "UnitCell"}


def open_entries():
    """Public functions with arguments, and classes that a user makes, whose entry is not checked."""
    for value in (value for module in NAMES for value in public(module) if callable(value)):
        entry = value.__init__ if inspect.isclass(value) else value
        made = inspect.isclass(value) and (issubclass(value, (Result, tuple)) or value.__name__ in MADE)
        within = {value.__module__.split(".")[1], value.__module__.removeprefix("granjax.")} & INSIDE
        if made or within or getattr(entry, "is_checked", False):
            continue
        if inspect.signature(value).parameters:
            yield f"{value.__module__}.{value.__qualname__}"


def test_every_public_function_is_checked():
    assert not sorted(set(open_entries()))


def test_columns_of_a_table_are_read():
    traces = gx.Traces([0.1, 0.2], velocity=np.ones((2, 2)), sites=Series([1, 2]))
    assert traces.places == ((1,), (2,))
    pairs = gx.Pairs(Series([0, 1]), Series([1, 2]))
    assert (pairs.tail, pairs.head) == ((0, 1), (1, 2))
    assert gx.laws.Spline(Series([-1.0, 1.0]), [1.0] * 3).knots == (-1.0, 1.0)
    names = ["a", "b", "a", "b"]
    for species in (Series(names), np.array(names, object), np.array(names)):
        assert list(gx.measures.species_energy(LATTICE, STATE, species=species)) == ["a", "b"]
    for wrong in (Series([1.5, 2.0]), Series([[[1]]]), Series(["a"])):
        with pytest.raises(ValueError, match="^sites: expected whole numbers"):
            gx.Traces([0.1, 0.2], velocity=np.zeros((2, 1)), sites=wrong)


def test_named_findings_meet_a_sentence():
    """Those of the trials that no type tells: shapes of the lattice, of sensors, of what a user's function gives."""
    chain = gx.scenes.monomer(7, precompression=1.0)
    times, data = np.linspace(0.1, 1.0, 6), np.zeros((6, 2))
    scene, traces = lambda p: gx.scenes.monomer(7, stiffness=p["k"]), gx.Traces(times, velocity=data, sites=[1, 2])
    none = jax.vmap(lambda k: gx.scenes.monomer(7, stiffness=k), out_axes=-1)(np.ones(0))
    fit = functools.partial(gx.fit, scene, {"k": 1.0}, traces)
    cases = (
        (lambda: gx.driven.driven_chain(chain, np.ones(7), 1.0), "amplitude: expected one number, got shape (7,)"),
        (lambda: gx.driven.driven_chain(chain, 0.1, 1.0, damping=np.ones(3)), "damping: expected one number, or one"),
        (lambda: gx.Traces(times, velocity=data, sites=[1, 2], sigma=[0.1] * 3), "sigma: expected a number, or"),
        (lambda: gx.Traces(times, velocity=data, sites=[1, [2, 3]]), "sites: expected whole numbers"),
        (lambda: fit(state=lambda p, lattice: 3.0), "state: expected a function (parameters, lattice)"),
        (lambda: fit(state=gx.states.impact(chain), t0=[0.0]), "t0: expected one number"),
        (lambda: fit(state=gx.states.impact(chain), seed=1.5), "seed: expected a whole number"),
        (lambda: fit(state=gx.states.impact(chain), bounds=[(0, 1)]), "bounds: expected a dict"),
        (lambda: fit(state=gx.states.impact(chain), optimiser=3), "optimiser: expected an optimiser of optax"),
        (lambda: fit(state=lambda p: gx.states.rest(chain)), "state: expected State(u, v) or a pair (u, v) or a fun"),
        (lambda: gx.fit(lambda p: gx.scenes.monomer(7, stiffness=p["K"]), {"k": 1.0}, traces, state=gx.states.rest(
            chain)), "scene: expected a function of a dict with 'k', got one that looks for 'K'. Did you mean 'k'?"),
        (lambda: gx.design(lambda p: p["kk"], {"k": 1.0}), "objective: expected a function of a dict with 'k', got"),
        (lambda: gx.design(lambda p, q: p["k"], {"k": 1.0}), "objective: expected a function of 1 argument"),
        (lambda: gx.newton.newton(lambda x, args: x, np.ones(1), linearise=lambda x: x), "linearise: expected a fun"),
        (lambda: gx.continuation.continuation(lambda x, p, args: x, np.ones(1), 0.0, stop=lambda x: None), "stop: exp"),
        (lambda: gx.continuation.continuation(lambda x, p, args: x, np.ones(1), 0.0, veto=lambda x: None), "veto: exp"),
        (lambda: gx.vector_field(0.0, gx.State(np.ones(6), np.ones(6)), chain), "y.u: expected shape (7,)"),
        (lambda: gx.Lattice(1.0, gx.Damping(0.1), sites=2.5), "sites: expected a whole number, or one per axis"),
        (lambda: gx.simulate(none, gx.states.rest(none), 1.0), "lattice: expected at least one lane, got an empty"),
        (lambda: gx.plots.traces(np.arange(3.0), np.ones((2, 4))), "ts and qs: expected as many times as frames, got"),
        (lambda: gx.plots.drawn(gx.plots.figure(), "doc"), "ending: expected one of"),
        (lambda: gx.plots.save(gx.plots.figure(), "a.doc"), "path: expected one of"),
        (lambda: gx.Flow(8, field=lambda t: t), "field: expected a function of 3 arguments"),
        (lambda: gx.simulate(chain, gx.states.rest(chain), 1.0, save_at=[0.1, [0.2]]), "save_at: expected"),
        (lambda: gx.scenes.monomer(10**12), "GB of memory hold"),
        (lambda: gx.newton.newton(lambda x, args: None, np.ones(2)), "residual: expected a function that gives"),
        (lambda: gx.forced.forced_branch(lambda p: None, 0.1, 0.2, period=1.0), "make: expected a function"),
        (lambda: gx.plots.profile(np.arange(3.0), np.ones(3), ax="axes"), "ax: expected matplotlib's Axes or None"),
    )
    for use, said in cases:
        with pytest.raises(ValueError, match=re.escape(said)):
            use()
            pytest.fail(said)
