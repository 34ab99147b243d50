"""XLA's flag, the floating type, threads, memory: what import sets, what it could not, and what is kept.

A flag makes loops over lattices faster on the CPU, diffrax's own too; a loop over arrays so large that XLA would use
all cores gets slower (benchmarks/flags.py). XLA reads it once, before JAX's first computation:
`xla_cpu_small_while_loop_byte_threshold`, an extra option of the backend, makes a loop one native function instead of a
dispatch per operation. Such a loop runs on one thread; cores are used through devices.

The rest is chosen by the processor: the width of vectors (an option of each program), the form of a contact's square
root, whether long chains are run in blocks, and how many lanes are run at a time.
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
# JAX from this version on has not been tried: XLA ends a process for a flag that it does not know
UNTRIED = (0, 13)


class Tuning(NamedTuple):
    """What is in force: the value of XLA_FLAGS, whether granjax's flag is in it, and a sentence."""

    flags: str
    complete: bool
    outcome: str


# seconds of compilation from which on a program is worth a file
WORTH_KEEPING = 0.1


def _processor():
    """What tells this processor from others, as far as the system says."""
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.read_text().split("\n\n")[0] if cpuinfo.is_file() else platform.processor()


def _has_avx512():
    return "avx512f" in _processor()


@cache
def wide_vectors() -> bool:
    """Whether granjax's programs are compiled for vectors of 512 bits: on a CPU that has them.

    That is an option of each program, which changes nothing else in the process. `GRANJAX_TUNE=0` forbids it.
    """
    import jax

    allowed = os.environ.get("GRANJAX_TUNE", "1") != "0"
    return allowed and jax.default_backend() == "cpu" and _has_avx512()


@cache
def root_by_products() -> bool:
    """Whether a square root of float64 is made of multiplications and additions: where that is the faster one.

    Over a whole run, roots by the processor's instruction take 1.2 to 1.4 times as long on Intel's with AVX-512, and
    0.7 to 0.85 times as long on AMD's Zen 5; others, and other devices than a CPU, use their instruction.
    `GRANJAX_ROOT=products` or `GRANJAX_ROOT=instruction` chooses by hand, before the first run: the two differ by a
    unit in the last place. **Raises** ValueError for another word.
    """
    from .checks import one_of

    chosen = os.environ.get("GRANJAX_ROOT")
    if chosen is not None:
        one_of("GRANJAX_ROOT", chosen, ("products", "instruction"))
        return chosen == "products"
    return _is_avx512_of("GenuineIntel")


@cache
def blocks_win() -> bool:
    """Whether long chains are faster block by block than stage by stage.

    On Intel's processors with AVX-512 they take 0.7 of the time at 1e5 sites and 0.4 at 1e6; on AMD's Zen 5 1.15 and
    1.1 of it. Others were not measured.
    """
    return _is_avx512_of("GenuineIntel")


@cache
def lanes_abreast() -> int:
    """The number of lanes of a batch with a fixed step that are run at a time; 0 for all of them together.

    The arrays of some lanes stay in the nearer caches. On Intel's processors with AVX-512 eight of them take 0.8 to 0.9
    of the time of all lanes together for chains of 20 to 1000 sites; on AMD's 64 of them take 0.5 to 1.0 of it.
    Others were not measured.
    """
    if _is_avx512_of("GenuineIntel"):
        return 8
    return 64 if _is_avx512_of("AuthenticAMD") else 0


def _is_avx512_of(maker):
    """Whether JAX computes on a processor of this maker with AVX-512."""
    import jax

    return jax.default_backend() == "cpu" and maker in _processor() and _has_avx512()


def _has_started():
    """Whether JAX has started, so that XLA has read its flags: only then JAX refuses another number of devices."""
    import jax

    now = jax.config.jax_num_cpu_devices
    try:
        jax.config.update("jax_num_cpu_devices", 2 if now == 1 else 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", now)
    return False


def tune(*, cache: bool = False) -> Tuning:
    """Set the XLA flag that makes loops on the CPU faster, if JAX has not started, and say what is in force.

    Import does this already unless the environment holds `GRANJAX_TUNE=0`. A value that the user has set stays.
    The flag is put in front of the others, because XLA reads nothing after a bare word. A JAX that is newer than those
    tried gets none: XLA ends a process for a flag that it does not know.

    **Arguments:** `cache`: keep compiled programs on disk too (`keep_compiled`), so that the next process does not
    compile them again.

    **Returns:** `Tuning(flags, complete, outcome)`; `complete` is false where JAX had started without the flag, or is
    newer than what was tried.

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
    """Keep compiled programs on disk, so that the next process does not compile them again. The command line does so.

    **Arguments:** `folder`: where; `None` is what `GRANJAX_CACHE` says, or granjax's folder in the user's cache
    folder. Below it every kind of processor has its own folder.

    **Returns:** the folder, or `None` where nothing is kept: `GRANJAX_CACHE=0`, or it cannot be written. A folder that
    the user has given to JAX itself stays. **Raises** ValueError for anything but a path.
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
    """Give the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def clear() -> None:
    """Let go of all compiled programs and of what is kept beside them, and hand the memory back to the system.

    JAX keeps the programs of every new shape, count of steps, record or solver as long as the process lives: some 31 MB
    for a run of a chain of another length. Of 925 MB after 30 lengths 100 stay, and after another 30 as many.
    Call it between the parts of a long study, or in a notebook, where many shapes were met; a loop over one shape keeps
    nothing. What was computed before stays as it is. The next call of anything compiles again, functions of your own
    under `jax.jit` included; what `keep_compiled` has on disk is read from there.
    """
    import equinox
    import jax

    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == __package__:
            for kept in list(vars(module).values()):
                if hasattr(kept, "cache_clear"):
                    kept.cache_clear()
    equinox.clear_caches()
    jax.clear_caches()
    gc.collect()
    # glibc keeps what was freed until it is asked
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _user_cache():
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home()))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def prepare_import() -> None:
    """What `import granjax` does first: float64 unless the environment says otherwise, and the XLA flag."""
    import jax

    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)
    if os.environ.get("GRANJAX_TUNE", "1") != "0":
        tune()


@cache
def pools() -> Any:
    """The libraries whose threads can be limited: `pools().limit(limits=1)`, a context."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread(function: Callable) -> Callable:
    """The function with LAPACK on one thread: below some 500 rows more threads only wait for each other."""

    @wraps(function)
    def limited(*arguments, **keywords):
        with pools().limit(limits=1):
            return function(*arguments, **keywords)

    return limited
