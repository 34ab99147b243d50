"""What tells one sweep from another: functions that do the same look alike in every process, all others do not."""

import functools
import os
import subprocess
import sys
import types

import jax
import numpy as np
import pytest

from granjax import outside
from granjax.sweeps.identity import differences, function_identity

HEAD = """
import functools, math
import jax, numpy as np, jax.numpy as jnp, equinox as eqx
from scipy.interpolate import CubicSpline
"""

# each of a pair gives another function of the same name
PAIRS = {
    "constant": ("def f(x): return x * 1 + 23", "def f(x): return x * 12 + 3"),
    "argument": ("def f(x, y): return x - y", "def f(y, x): return x - y"),
    "operation": ("def f(x): return x + x", "def f(x): return x * x"),
    "reach of try": (
        "def f(x):\n  try:\n    a = 1 / x\n    b = g(x)\n  except ZeroDivisionError:\n    a = b = 0\n"
        "  return a + b",
        "def f(x):\n  try:\n    a = 1 / x\n  except ZeroDivisionError:\n    a = 0\n  b = g(x)\n  return a + b",
    ),
    "kind of constant": ("def f(x): return x * 1", "def f(x): return x * True"),
    "sign of zero": ("def f(x): return x * 0.0", "def f(x): return x * -0.0"),
    "set": ("def f(x): return x in {1, 2, 3}", "def f(x): return x in {1, 2, 4}"),
    "global": ("K = 1\ndef f(x): return x * K", "K = 2\ndef f(x): return x * K"),
    "kind of a global": ("K = 1\ndef f(x): return x * K", "K = 1.0\ndef f(x): return x * K"),
    "precision of a global": (
        "K = np.float32(0.5)\ndef f(x): return x * K",
        "K = np.float64(0.5)\ndef f(x): return x * K",
    ),
    "list": ("K = [1, 2]\ndef f(x): return sum(K)", "K = [1, 3]\ndef f(x): return sum(K)"),
    "list or tuple": ("K = [1, 2]\ndef f(x): return K * 2", "K = (1, 2)\ndef f(x): return K * 2"),
    "empty list": ("K = []\ndef f(x): return len(K)", "K = {}\ndef f(x): return len(K)"),
    "deep list": ("K = [[[[[[[[[1]]]]]]]]]\ndef f(x): return K", "K = [[[[[[[[[2]]]]]]]]]\ndef f(x): return K"),
    "long list": ("K = list(range(99))\ndef f(x): return K", "K = [*range(98), 7]\ndef f(x): return K"),
    "long list of lists": (
        "K = [[i] for i in range(99)]\ndef f(x): return K",
        "K = [[i] for i in range(98)] + [[7]]\ndef f(x): return K",
    ),
    "dict": ("K = {'a': 1}\ndef f(x): return K['a']", "K = {'a': 2}\ndef f(x): return K['a']"),
    "array": ("K = np.arange(5)\ndef f(x): return K", "K = np.arange(5) * 2\ndef f(x): return K"),
    "key": ("K = jax.random.key(0)\ndef f(x): return K", "K = jax.random.key(1)\ndef f(x): return K"),
    "default": ("def f(x, k=1): return x * k", "def f(x, k=2): return x * k"),
    "keyword's default": ("def f(x, *, k=1): return x * k", "def f(x, *, k=2): return x * k"),
    "closure": (
        "def m(k):\n  def f(x): return x * k\n  return f\nf = m(1)",
        "def m(k):\n  def f(x): return x * k\n  return f\nf = m(2)",
    ),
    "two of one code": (
        "def m(k): return lambda x: x * k\na = m(1); b = m(2)\ndef f(x): return a(x) + b(x)",
        "def m(k): return lambda x: x * k\na = m(1); b = m(3)\ndef f(x): return a(x) + b(x)",
    ),
    "chain of calls": (
        "def g0(x): return g1(x)\ndef g1(x): return g2(x)\ndef g2(x): return g3(x)\ndef g3(x): return g4(x)\n"
        "def g4(x): return g5(x)\ndef g5(x): return g6(x)\ndef g6(x): return g7(x)\ndef g7(x): return g8(x)\n"
        "def g8(x): return g9(x)\ndef g9(x): return g10(x)\ndef g10(x): return g11(x)\n"
        "def g11(x): return g12(x)\ndef g12(x): return x\ndef f(x): return g0(x)",
        "def g0(x): return g1(x)\ndef g1(x): return g2(x)\ndef g2(x): return g3(x)\ndef g3(x): return g4(x)\n"
        "def g4(x): return g5(x)\ndef g5(x): return g6(x)\ndef g6(x): return g7(x)\ndef g7(x): return g8(x)\n"
        "def g8(x): return g9(x)\ndef g9(x): return g10(x)\ndef g10(x): return g11(x)\n"
        "def g11(x): return g12(x)\ndef g12(x): return -x\ndef f(x): return g0(x)",
    ),
    "ufunc": ("from numpy import sin as s\ndef f(x): return s(x)", "from numpy import cos as s\ndef f(x): return s(x)"),
    "function of jax": ("s = jnp.sin\ndef f(x): return s(x)", "s = jnp.cos\ndef f(x): return s(x)"),
    "builtin": ("s = math.sin\ndef f(x): return s(x)", "s = math.cos\ndef f(x): return s(x)"),
    "grad": (
        "def g(x, y): return x * y * y\nd = jax.grad(g, 0)\ndef f(x): return d(x, x)",
        "def g(x, y): return x * y * y\nd = jax.grad(g, 1)\ndef f(x): return d(x, x)",
    ),
    "grad or not": (
        "def g(x): return x * x\nd = jax.grad(g)\ndef f(x): return d(x)",
        "def g(x): return x * x\nd = jax.jit(g)\ndef f(x): return d(x)",
    ),
    "jit": ("@jax.jit\ndef f(x): return x * 2", "@jax.jit\ndef f(x): return x * 3"),
    "jit of partial": (
        "def g(k, x): return x * k\nf = jax.jit(functools.partial(g, 2))",
        "def g(k, x): return x * k\nf = jax.jit(functools.partial(g, 3))",
    ),
    "vmap": (
        "def g(k, x): return x * k\nf = jax.vmap(g, (0, None))",
        "def g(k, x): return x * k\nf = jax.vmap(g, (None, 0))",
    ),
    "rule of a derivative": (
        "@jax.custom_jvp\ndef g(x): return x\n@g.defjvp\ndef r(p, t): return p[0], t[0]\n"
        "def f(x): return jax.grad(g)(x)",
        "@jax.custom_jvp\ndef g(x): return x\n@g.defjvp\ndef r(p, t): return p[0], 2 * t[0]\n"
        "def f(x): return jax.grad(g)(x)",
    ),
    "partial": (
        "def g(k, x): return x * k\nf = functools.partial(g, 2)",
        "def g(k, x): return x * k\nf = functools.partial(g, 3)",
    ),
    "partial by name": (
        "def g(x, k): return x * k\nf = functools.partial(g, k=2)",
        "def g(x, k): return x * k\nf = functools.partial(g, k=3)",
    ),
    "cache": ("@functools.lru_cache\ndef f(x): return x * 2", "@functools.lru_cache\ndef f(x): return x * 3"),
    "callable object": (
        "class C:\n  def __init__(s, k): s.k = k\n  def __call__(s, x): return x * s.k\nf = C(1)",
        "class C:\n  def __init__(s, k): s.k = k\n  def __call__(s, x): return x * s.k\nf = C(2)",
    ),
    "method of an object": (
        "class C:\n  def g(s, x): return x\nM = C()\ndef f(x): return M.g(x)",
        "class C:\n  def g(s, x): return -x\nM = C()\ndef f(x): return M.g(x)",
    ),
    "method that a call uses": (
        "class C:\n  def g(s, x): return x\n  def __call__(s, x): return s.g(x)\nf = C()",
        "class C:\n  def g(s, x): return -x\n  def __call__(s, x): return s.g(x)\nf = C()",
    ),
    "bound method": (
        "class C:\n  def g(s, x): return x\n  def h(s, x): return s.g(x)\nf = C().h",
        "class C:\n  def g(s, x): return -x\n  def h(s, x): return s.g(x)\nf = C().h",
    ),
    "constant of a class": (
        "class C:\n  K = 1\n  def __call__(s, x): return x * s.K\nf = C()",
        "class C:\n  K = 2\n  def __call__(s, x): return x * s.K\nf = C()",
    ),
    "base": (
        "class B:\n  def g(s): return 1\nclass C(B): pass\ndef f(x): return C().g() * x",
        "class B:\n  def g(s): return 2\nclass C(B): pass\ndef f(x): return C().g() * x",
    ),
    "property": (
        "class C:\n  @property\n  def k(s): return 1\nM = C()\ndef f(x): return M.k * x",
        "class C:\n  @property\n  def k(s): return 2\nM = C()\ndef f(x): return M.k * x",
    ),
    "slots": (
        "class C:\n  __slots__ = 'k'\nM = C(); M.k = 1\ndef f(x): return M.k * x",
        "class C:\n  __slots__ = 'k'\nM = C(); M.k = 2\ndef f(x): return M.k * x",
    ),
    "module of equinox": (
        "class L(eqx.Module):\n  k: float\n  def force(s, x): return s.k * x\nM = L(1.0)\n"
        "def f(x): return M.force(x)",
        "class L(eqx.Module):\n  k: float\n  def force(s, x): return -s.k * x\nM = L(1.0)\n"
        "def f(x): return M.force(x)",
    ),
    "field of it": (
        "class L(eqx.Module):\n  k: float = 1.0\n  def force(s, x): return s.k * x\ndef f(x): return L().force(x)",
        "class L(eqx.Module):\n  k: float = 2.0\n  def force(s, x): return s.k * x\ndef f(x): return L().force(x)",
    ),
    "spline": (
        "S = CubicSpline([0, 1, 2], [0, 1, 4])\ndef f(x): return S(x)",
        "S = CubicSpline([0, 1, 2], [0, 1, 5])\ndef f(x): return S(x)",
    ),
    "generator": (
        "R = np.random.default_rng(1)\ndef f(x): return R",
        "R = np.random.default_rng(2)\ndef f(x): return R",
    ),
    "lambda": ("f = lambda x: x + 1", "f = lambda x: x + 2"),
    "inner": (
        "def f(x):\n  def g(y): return y + 1\n  return g(x)",
        "def f(x):\n  def g(y): return y + 2\n  return g(x)",
    ),
}


def made(source, name="__main__", file="<cell 1>"):
    scope = {"__name__": name}
    exec(compile(HEAD + source, file, "exec"), scope)
    return scope["f"]


@pytest.mark.parametrize("kind", PAIRS)
def test_functions_that_differ_look_different_and_the_same_ones_alike(kind):
    one, other = PAIRS[kind]
    first = function_identity(made(one))
    moved = function_identity(made("\n# moved\n\n" + one.replace("\ndef", "  # a remark\n\ndef"), "pulses", "other.py"))
    assert first == moved
    assert first != function_identity(made(other))


TELLING = """
import json, sys
sys.path.insert(0, {folder!r})
import test_sweep_identity as t
print(json.dumps({{k: t.function_identity(t.made(s[0])) for k, s in t.PAIRS.items()}}, sort_keys=True))
"""


@pytest.mark.study
def test_identities_are_the_same_in_every_process():
    text = TELLING.format(folder=os.path.dirname(__file__))
    found = [subprocess.Popen([sys.executable, "-c", text], env={**os.environ, "PYTHONHASHSEED": seed},
                              stdout=subprocess.PIPE, text=True) for seed in ("1", "2")]
    one, two = (process.communicate()[0] for process in found)
    assert one == two and len(one) > 1000


def test_a_module_that_is_imported_within_counts(tmp_path, monkeypatch):
    """And one that is called as a module of Python's own is."""
    monkeypatch.syspath_prepend(tmp_path)
    place = tmp_path / "own_pulses_1.py"
    place.write_text("def g(x): return x")
    f = made("def f(x):\n  from own_pulses_1 import g\n  return g(x)")
    first = function_identity(f)
    place.write_text("# a remark\ndef g(x): return x")
    assert function_identity(f) == first
    place.write_text("def g(x): return 2 * x")
    assert function_identity(f) != first


def test_a_file_of_ones_own_may_have_the_name_of_one_of_pythons(tmp_path, monkeypatch):
    found = set()
    for text in ("def g(x): return x", "def g(x): return 2 * x", "\n\ndef g(x): return x"):
        own = types.ModuleType("wave")
        own.__file__ = str(tmp_path / "wave.py")
        exec(text, vars(own))
        monkeypatch.setitem(sys.modules, "wave", own)
        outside._known.cache_clear()
        outside.is_library.cache_clear()
        f = types.FunctionType(made("def f(x): return wave.g(x)").__code__, {"wave": own})
        found.add(function_identity(f)["code"])
    outside._known.cache_clear()
    outside.is_library.cache_clear()
    assert len(found) == 2


def test_recursion_and_loops_end():
    loop = []
    loop.append(loop)

    def even(n):
        return n == 0 or odd(n - 1)

    def odd(n):
        return n != 0 and even(n - 1) and bool(loop)

    assert function_identity(even) == function_identity(even)
    assert function_identity(functools.partial(even)) == function_identity(functools.partial(even))


def test_the_difference_is_in_words():
    def of(source):
        return {"function": function_identity(made(source)), "parameters": {}, "versions": {}}

    assert differences(of("K = 1\ndef f(x): return x * K"), of("K = 2\ndef f(x): return x * K")) == [
        "function: it reads K = 2, in the store 1"]
    for one, other in PAIRS.values():
        assert differences(of(one), of(other))


def test_what_was_called_is_as_it_was():
    """Calling a function changes nothing: what JAX and functools keep of it is none of it."""
    for kind in ("jit", "cache", "spline", "grad", "rule of a derivative"):
        f = made(PAIRS[kind][0])
        before = function_identity(f)
        jax.block_until_ready(f(np.float64(0.5)))
        assert function_identity(f) == before, kind


@pytest.mark.study
def test_what_is_loaded_later_changes_nothing():
    """Parts of a library that are loaded when they are first asked for."""
    script = """
import granjax as gx
from granjax.sweeps.identity import function_identity

def struck(ratio):
    chain = gx.scenes.dimer(3, ratio=ratio)
    return gx.states.impact(chain).v

before = function_identity(struck)
struck(0.5)
assert function_identity(struck) == before, (before, function_identity(struck))
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)
