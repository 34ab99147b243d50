"""What import sets, in fresh processes; what is kept on disk and in memory."""

import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest
from refusals import refused

import granjax as gx
from granjax.base import programs, tuning

OWN = "XLA_FLAGS", "GRANJAX_TUNE", "JAX_ENABLE_X64", "GRANJAX_CACHE", "JAX_COMPILATION_CACHE_DIR"


def said(code, **environment):
    """What a fresh process prints in its last line, as JSON."""
    names = {k: v for k, v in os.environ.items() if k not in OWN}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=names | environment,
    )
    return json.loads(done.stdout.splitlines()[-1])


CHANGES = """
import atexit, gc, json, os, signal, sys, threading, warnings
# what granjax stands on may do as it likes
import diffrax, equinox, h5netcdf, jax, jaxtyping, matplotlib.pyplot, numpy, optax, pandas, scipy, tqdm, xarray
import jax.interpreters.mlir, jax.scipy.special, multiprocessing.util, scipy.optimize, scipy.sparse.linalg, scipy.io
from jax._src.interpreters import mlir

def now():
    found = {f"{name}.{key}": id(x) for name, module in list(sys.modules.items()) if name.partition(".")[0] in OTHERS
             for key, x in list(vars(module).items()) if callable(x)}
    found |= {f"lowering of {key}": id(x) for key, x in mlir._lowerings.items()}
    found |= {f"signal {s}": str(signal.getsignal(s)) for s in signal.valid_signals()}
    found |= {name: id(getattr(sys, name)) for name in ("excepthook", "unraisablehook", "displayhook")}
    found |= {f"environment {name}": x for name, x in os.environ.items() if name != "XLA_FLAGS"}
    found |= {f"config {name}": str(x) for name, x in jax.config.values.items() if name != "jax_enable_x64"}
    found |= {f"rcParams {name}": str(x) for name, x in matplotlib.rcParams.items()}
    found |= {"threads": threading.active_count(), "thread hook": id(threading.excepthook)}
    found |= {"exits": atexit._ncallbacks(), "gc": [gc.isenabled(), gc.get_freeze_count(), gc.get_threshold()]}
    found |= {"filters": str(warnings.filters), "numpy": str((numpy.geterr(), numpy.get_printoptions()))}
    found |= {"flags": os.environ.get("XLA_FLAGS", ""), "float64": jax.config.jax_enable_x64}
    return found | {"path": list(sys.path)}

OTHERS = {"jax", "jaxlib", "equinox", "diffrax", "numpy", "signal", "gc", "atexit", "warnings", "sys", "threading"}
before = now()
import granjax
for name in granjax.__all__:
    getattr(granjax, name)
after = now()
changed = [name for name in before if before[name] != after.get(name)]
print(json.dumps([[name, str(before[name]), str(after.get(name))] for name in changed]))
"""


@pytest.mark.slow
def test_import_sets_float64_and_a_flag_and_changes_nothing_else():
    changed = {name: values for name, *values in said(CHANGES)}
    assert changed.keys() == {"float64", "flags"}
    assert changed["float64"] == ["False", "True"]
    assert changed["flags"][1].strip() == tuning.LOOPS


@pytest.mark.slow
def test_the_environment_turns_both_off():
    code = """
import json, os
import granjax, jax.numpy as jnp
print(json.dumps([os.environ.get("XLA_FLAGS", ""), str(jnp.zeros(()).dtype)]))
"""
    assert said(code, GRANJAX_TUNE="0", JAX_ENABLE_X64="0") == ["", "float32"]


def test_flags_of_the_user_stay_and_too_late_is_said(monkeypatch):
    # XLA reads its flags here, and none of those below
    jnp.zeros(()).block_until_ready()
    own = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=7"
    monkeypatch.setenv("XLA_FLAGS", own)
    assert gx.tune()[:2] == (own, True)
    monkeypatch.setenv("XLA_FLAGS", "bare_word=1")
    late = gx.tune()
    assert late[:2] == ("bare_word=1", False) and "before its first computation" in late.outcome
    # XLA reads nothing after a bare word
    monkeypatch.setattr(tuning, "_has_started", lambda: False)
    assert gx.tune()[:2] == (f"{tuning.LOOPS} bare_word=1", True)
    assert os.environ["XLA_FLAGS"] == f"{tuning.LOOPS} bare_word=1"


@pytest.mark.parametrize(
    "vendor, flags, chosen, products",
    [
        ("GenuineIntel", "avx2 avx512f", None, True),
        ("AuthenticAMD", "avx2 avx512f", None, False),
        ("GenuineIntel", "avx2", None, False),
        ("AuthenticAMD", "avx512f", "products", True),
        ("GenuineIntel", "avx512f", "instruction", False),
    ],
)
def test_the_form_of_a_root_is_the_processor_s(vendor, flags, chosen, products, monkeypatch):
    choose = tuning.root_by_products.__wrapped__
    monkeypatch.setattr(tuning, "_processor", lambda: f"vendor_id : {vendor}\nflags : {flags}")
    monkeypatch.delenv("GRANJAX_ROOT", raising=False)
    if chosen:
        monkeypatch.setenv("GRANJAX_ROOT", chosen)
    assert choose() == products
    monkeypatch.setenv("GRANJAX_ROOT", "product")
    with refused("GRANJAX_ROOT.*'products'"):
        choose()


@pytest.mark.slow
def test_programs_are_kept_where_the_environment_says(tmp_path):
    # a folder that cannot be made is no reason to fail
    (tmp_path / "file").write_text("")
    code = f"""
import json, os
from pathlib import Path
import jax
from granjax.base import tuning

def kept(**names):
    os.environ.update(names)
    place = tuning.keep_compiled()
    used = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    return [place and str(place), used]

base = Path({str(tmp_path)!r})
found = [kept(GRANJAX_CACHE="0"), kept(GRANJAX_CACHE=str(base / "file")), kept(GRANJAX_CACHE=str(base / "mine"))]
del os.environ["GRANJAX_CACHE"]
found.append(kept(XDG_CACHE_HOME=str(base), HOME=str(base)))
jax.config.update("jax_compilation_cache_dir", str(base / "own"))
print(json.dumps([*found, kept()]))
"""
    off, unwritable, mine, home, own = said(code)
    assert off == unwritable == [None, None]
    assert mine[0] == mine[1] and mine[0].startswith(str(tmp_path / "mine"))
    assert home[0] == home[1] and home[0].startswith(str(tmp_path)) and "granjax" in home[0]
    assert own == [str(tmp_path / "own")] * 2


@pytest.mark.slow
def test_rooms_are_imported_without_scipy_s_packages():
    """Those of sparse matrices and of optimisers take longer to import than all rooms together."""
    code = """
import json, sys
import granjax as gx
gx.scenes, gx.newton, gx.equilibrium, gx.states, gx.linear, gx.orbits, gx.travelling, gx.shocks, gx.first_order
print(json.dumps([name for name in ("sparse", "optimize", "linalg") if f"scipy.{name}" in sys.modules]))
"""
    assert said(code) == []


@pytest.mark.slow
def test_scipy_s_lapack_has_one_thread_also_where_it_is_loaded_later():
    code = """
import json
from granjax.base import tuning

@tuning.one_thread
def threads():
    import scipy.linalg
    from threadpoolctl import threadpool_info
    return [known["num_threads"] for known in threadpool_info() if known["user_api"] == "blas"]

print(json.dumps(threads()))
"""
    # NumPy's library and SciPy's, or one that both share
    assert said(code, OPENBLAS_NUM_THREADS="2") in ([1], [1, 1])


@pytest.mark.slow
def test_the_next_process_finds_what_was_compiled(tmp_path):
    code = """
import json
import granjax as gx
import jax
gx.tune(cache=True)
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if "cache_hits" in event else None)
chain = gx.scenes.monomer(9)
run = gx.simulate(chain, gx.states.impact(chain), 3.0, step=0.1)
print(json.dumps([len(hits), float(run.final.u[0])]))
"""
    first, second = (said(code, GRANJAX_CACHE=str(tmp_path)) for _ in range(2))
    assert first[0] == 0 and second[0] > 0 and first[1] == second[1]


@pytest.mark.slow
def test_the_next_process_compiles_no_run_again_that_saves_frames(tmp_path):
    # JAX keeps no program that calls Python
    code = """
import json
import granjax as gx
import jax
gx.tune(cache=True)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
missed = []
jax.monitoring.register_event_listener(lambda event, **_: missed.append(event) if "cache_misses" in event else None)
chain = gx.scenes.monomer(9)
state = gx.states.impact(chain)
gx.simulate(chain, state, 3.0, step=0.1, save_at=[1.0, 2.0])
gx.simulate(chain, state, 3.0, tolerance=1e-8, save_at=4)
print(len(missed))
"""
    first, second = (said(code, GRANJAX_CACHE=str(tmp_path)) for _ in range(2))
    assert first > 2 and second == 0


ONE_MORE_LENGTH = """
import json, os
from pathlib import Path
import granjax as gx
from granjax.terms import reach

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def run(sites):
    chain = gx.scenes.dimer(sites)
    return chain, gx.simulate(chain, gx.states.impact(chain), 2.0, step=0.1)

run(5)
gx.clear()
before = resident()
chain, found = run(6)
grown = resident() - before
gx.clear()
left = resident() - before
kept = reach._traced_force.cache_info().currsize
again = run(6)[1].final.u
same = (again == found.final.u).all().item()
print(json.dumps([grown, left, kept, found.to_xarray().sizes["site"], same]))
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not os.path.exists("/proc/self/statm"), reason="the system does not say what is resident"
)
def test_clear_hands_memory_back_and_leaves_results():
    grown, left, caches, sites, same = said(ONE_MORE_LENGTH)
    assert grown > 15e6 and left < 0.3 * grown and caches == 0
    assert sites == 6 and same


class Arctangent(gx.Law):
    """A softening law by the operation that jaxlib 0.10.2 gets wrong in vectors of 512 bits."""

    def force(self, e):
        return jnp.arctan(e)

    def energy(self, e):
        return e * jnp.arctan(e) - 0.5 * jnp.log1p(e**2)


def test_a_law_with_an_arctangent_keeps_its_energy():
    """Jax issue 39352: no program with this operation takes wide vectors, whichever processor this is."""
    chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), Arctangent()), sites=40)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=3.0), 10.0, step=0.05)
    assert run.energy_error < 1e-10


def test_programs_within_loops_are_looked_through():
    def loop(x):
        step = lambda c, _: (jax.lax.cond(c[0] > 0, jnp.arctan, jnp.sin, c), None)
        return jax.lax.scan(step, x, length=3)

    assert programs.holds(jax.make_jaxpr(loop)(jnp.ones(3)).jaxpr, "atan")
    assert not programs.holds(jax.make_jaxpr(jnp.sin)(jnp.ones(3)).jaxpr, "atan")
