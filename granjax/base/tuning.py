"""Settings of the process: XLA's flag, the floating type, threads and memory.

XLA reads the flag once, before JAX's first computation: `xla_cpu_small_while_loop_byte_threshold`,
an extra option of the backend. It compiles a loop into one native function on one thread instead of
a dispatch per operation, so cores are used through devices. Loops over lattices on the CPU get
faster, also those of diffrax; a loop over arrays so large that XLA would use all cores gets slower
(benchmarks/flags.py).

Other settings depend on the processor: the width of vectors (an option of each program), the form
of a contact's square root, whether long chains run in blocks, and how many lanes run at a time.
"""

import contextlib
import ctypes
import gc
import hashlib
import os
import platform
import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, NamedTuple

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000000"
# JAX versions from this one on have not been tried: XLA ends a process for a flag that it does not
# know.
UNTRIED = (0, 13)


class Tuning(NamedTuple):
    """What is in force: the value of XLA_FLAGS, whether granjax's flag is in it, and a sentence."""

    flags: str
    complete: bool
    outcome: str


# Programs that compile for at least this many seconds are written to disk.
WORTH_KEEPING = 0.1


def _processor():
    # Identifies the processor, as far as the system tells.
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.read_text().split("\n\n")[0] if cpuinfo.is_file() else platform.processor()


def _has_avx512():
    return "avx512f" in _processor()


@cache
def wide_vectors() -> bool:
    """Return whether programs are compiled for vectors of 512 bits: on a CPU that has them.

    It is an option of each program of granjax, and changes nothing else in the process.
    `GRANJAX_TUNE=0` forbids it.
    """
    import jax

    allowed = os.environ.get("GRANJAX_TUNE", "1") != "0"
    return allowed and jax.default_backend() == "cpu" and _has_avx512()


@cache
def root_by_products() -> bool:
    """Return whether multiplications and additions replace the square root of float64.

    Over a whole run, the processor's root instruction takes 1.2 to 1.4 times as long on Intel's
    processors with AVX-512, and 0.7 to 0.85 times as long on AMD's Zen 5. So only Intel's replace
    it. `GRANJAX_ROOT=products` or `GRANJAX_ROOT=instruction`, before the first run, overrides the
    choice; the two differ by a unit in the last place.

    **Raises** ValueError for another word.
    """
    from .checks import one_of

    chosen = os.environ.get("GRANJAX_ROOT")
    if chosen is not None:
        one_of("GRANJAX_ROOT", chosen, ("products", "instruction"))
        return chosen == "products"
    return _is_avx512_of("GenuineIntel")


@cache
def blocks_win() -> bool:
    """Return whether long chains are faster block by block than stage by stage.

    Blocks take 0.7 of the time at 1e5 sites and 0.4 at 1e6 on Intel's processors with AVX-512, but
    1.15 and 1.1 on AMD's Zen 5. Others were not measured.
    """
    return _is_avx512_of("GenuineIntel")


@cache
def lanes_abreast() -> int:
    """Return how many lanes of a batch with a fixed step run at a time; 0 for all together.

    The arrays of a few lanes stay in the nearer caches. Compared with all lanes together, eight
    lanes take 0.8 to 0.9 of the time on Intel's processors with AVX-512, for chains of 20 to 1000
    sites; 64 lanes take 0.5 to 1.0 on AMD's. Others were not measured.
    """
    if _is_avx512_of("GenuineIntel"):
        return 8
    return 64 if _is_avx512_of("AuthenticAMD") else 0


def _is_avx512_of(maker):
    import jax

    return jax.default_backend() == "cpu" and maker in _processor() and _has_avx512()


def _has_started():
    # Once JAX has started, and XLA has read its flags, JAX refuses another number of devices.
    import jax

    now = jax.config.jax_num_cpu_devices
    try:
        jax.config.update("jax_num_cpu_devices", 2 if now == 1 else 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", now)
    return False


def tune(*, cache: bool = False) -> Tuning:
    """Set the XLA flag for faster loops on the CPU if JAX has not started; say what is in force.

    Import does this already unless the environment has `GRANJAX_TUNE=0`. A value that the user has
    set stays. The flag precedes others, because XLA reads nothing after a bare word. A JAX newer
    than those tried gets no flag, since XLA ends a process for a flag that it does not know.

    **Arguments:** `cache`: also keep compiled programs on disk (`keep_compiled`), so that the next
    process does not compile them again.

    **Returns:** `Tuning(flags, complete, outcome)`; `complete` is false if JAX started without the
    flag, or is too new.

    **Example:**

    >>> gx.tune().complete
    True
    """
    import jax

    if cache:
        keep_compiled()
    flags = os.environ.get("XLA_FLAGS", "")
    if LOOPS.split("=")[1] in flags:
        return Tuning(flags, True, "In XLA_FLAGS.")
    if jax.__version_info__ >= UNTRIED:
        return Tuning(
            flags,
            False,
            f"Not set: JAX {jax.__version__} is newer than those granjax was tried with, and XLA ends a process for a "
            f"flag that it does not know. Put {LOOPS} into XLA_FLAGS yourself to have it.",
        )
    if _has_started():
        return Tuning(
            flags,
            False,
            f"Too late: JAX has started, and XLA reads {LOOPS} only before its first computation. "
            "Import granjax, or call granjax.tune(), before computing with JAX.",
        )
    os.environ["XLA_FLAGS"] = flags = f"{LOOPS} {flags}".strip()
    return Tuning(flags, True, f"Set {LOOPS}.")


def keep_compiled(folder: str | Path | None = None) -> Path | None:
    """Keep compiled programs on disk, so that the next process does not compile them again.

    The command line does so.

    **Arguments:** `folder`: `None` is the value of `GRANJAX_CACHE`, or granjax's folder in the
    user's cache folder. Each kind of processor has its own subfolder.

    **Returns:** the folder, or `None` where nothing is kept: with `GRANJAX_CACHE=0`, or if it
    cannot be written. A folder that the user has given to JAX stays.

    **Raises** ValueError for anything but a path.
    """
    import jax

    from .checks import described, refuse

    if folder is not None and not isinstance(folder, (str, os.PathLike)):
        refuse("folder", "a string, a path or None", described(folder))
    if jax.config.jax_compilation_cache_dir:
        return Path(jax.config.jax_compilation_cache_dir)
    chosen = folder or os.environ.get("GRANJAX_CACHE") or _user_cache() / "granjax"
    if str(chosen) == "0":
        return None
    lines = [
        line
        for line in _processor().splitlines()
        if line.split(":")[0].strip() in ("model name", "flags")
    ]
    own = hashlib.sha256("".join(lines or [_processor()]).encode()).hexdigest()[:12]
    place = Path(chosen) / f"{platform.machine()}-{own}"
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(place, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(place))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return place


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def clear() -> None:
    """Release all compiled programs and caches, and return the memory to the system.

    JAX keeps the programs for each new shape, number of steps, record or solver while the process
    lives: about 31 MB for a run of a chain of another length. Call it between parts of a long
    study, or in a notebook, that use many shapes; a loop over one shape accumulates nothing.
    Results stay valid. The next call of anything compiles again, also your own functions under
    `jax.jit`, unless `keep_compiled` has it on disk.
    """
    import equinox
    import jax

    package = __package__.partition(".")[0]
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == package:
            for kept in list(vars(module).values()):
                if hasattr(kept, "cache_clear"):
                    kept.cache_clear()
    equinox.clear_caches()
    jax.clear_caches()
    gc.collect()
    # glibc keeps freed memory until it is asked to return it.
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _user_cache():
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home()))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def prepare_import() -> None:
    """Prepare the import of granjax: float64, unless the environment chooses, and the XLA flag."""
    import jax

    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)
    if os.environ.get("GRANJAX_TUNE", "1") != "0":
        tune()


@cache
def pools() -> Any:
    """Return the libraries whose threads can be limited: `pools().limit(limits=1)`, a context."""
    # A controller knows the libraries that are loaded before it, and SciPy has its own LAPACK.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread(function: Callable) -> Callable:
    """Return the function with LAPACK on one thread, faster below some 500 rows."""

    @wraps(function)
    def limited(*arguments, **keywords):
        with pools().limit(limits=1):
            return function(*arguments, **keywords)

    return limited
