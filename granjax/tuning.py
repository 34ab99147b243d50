"""XLA's flags and the floating type: what import sets, and what it could not.

Two flags make every loop on the CPU faster, diffrax's own too. XLA reads them once, before JAX's first computation:

- `xla_cpu_small_while_loop_byte_threshold`, an extra option of the backend: a loop becomes one native function instead
  of a dispatch per operation. Such a loop runs on one thread; cores are used through devices.
- `xla_cpu_prefer_vector_width=512` on processors with AVX-512.
"""

import os
from pathlib import Path
from typing import NamedTuple

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000000"
WIDTH = "--xla_cpu_prefer_vector_width=512"


class Tuning(NamedTuple):
    """What is in force: the value of XLA_FLAGS, whether nothing of granjax's is missing, and a sentence."""

    flags: str
    complete: bool
    message: str


def _has_avx512():
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.is_file() and "avx512f" in cpuinfo.read_text()


def _missing(flags):
    """granjax's flags that are not in a value of XLA_FLAGS under any value: what the user has set stays."""
    wanted = [LOOPS] + ([WIDTH] if _has_avx512() else [])
    return [flag for flag in wanted if flag.split("=")[0] not in flags]


def _started():
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def tune():
    """Set granjax's XLA flags if JAX has not started computing yet, and say what is in force.

    Import does this already unless the environment holds `GRANJAX_TUNE=0`. A flag that the user has set in XLA_FLAGS
    stays as it is. granjax's flags are put in front, because XLA reads nothing after a bare word.

    **Returns:** `Tuning(flags, complete, message)`; `complete` is false where JAX had started without them.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    missing = _missing(flags)
    if not missing:
        return Tuning(flags, True, "In XLA_FLAGS.")
    if _started():
        return Tuning(
            flags, False,
            f"Too late: JAX has started, and XLA reads {' '.join(missing)} only before its first computation. "
            "Import granjax, or call granjax.tune(), before computing with JAX.",
        )
    os.environ["XLA_FLAGS"] = flags = " ".join([*missing, flags]).strip()
    return Tuning(flags, True, f"Set {' '.join(missing)}.")


def prepare_import():
    """What `import granjax` does first: float64 unless the environment says otherwise, and the XLA flags."""
    import jax

    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)
    if os.environ.get("GRANJAX_TUNE", "1") != "0":
        tune()
