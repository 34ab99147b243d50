"""XLA's flags and the floating type: what import sets, and what it could not.

Two flags make every loop on the CPU faster, diffrax's own too. XLA reads them once, before JAX's first computation:

- `xla_cpu_small_while_loop_byte_threshold`, an extra option of the backend: a loop becomes one native function instead
  of 65 ns of dispatch per operation. Such a loop runs on one thread; cores are used through devices.
- `xla_cpu_prefer_vector_width=512` on processors with AVX-512.
"""

import os
from pathlib import Path
from typing import NamedTuple

LOOPS = "xla_cpu_small_while_loop_byte_threshold"
OPTIONS = "--xla_backend_extra_options"
WIDTH = "--xla_cpu_prefer_vector_width"


class Tuning(NamedTuple):
    """What is in force: the value of XLA_FLAGS, whether both of granjax's flags are in it, and a sentence."""

    flags: str
    complete: bool
    message: str


def _has_avx512():
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.is_file() and "avx512f" in cpuinfo.read_text()


def _wanted(flags):
    """The flags that granjax would add to a value of XLA_FLAGS: none that the user has set in any form."""
    wanted = []
    if OPTIONS not in flags:
        wanted.append(f"{OPTIONS}={LOOPS}=100000000000")
    if WIDTH not in flags and _has_avx512():
        wanted.append(f"{WIDTH}=512")
    return wanted


def _started():
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def tune():
    """Set granjax's XLA flags if JAX has not started computing yet, and say what is in force.

    Import does this already unless the environment holds `GRANJAX_TUNE=0`. A flag that the user has set in XLA_FLAGS
    stays as it is. granjax's flags are put in front, because XLA reads nothing after a bare word.

    **Returns:** `Tuning(flags, complete, message)`.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = _wanted(flags)
    if wanted and _started():
        return Tuning(
            flags, False,
            f"Too late: JAX has started, and XLA reads {' '.join(wanted)} only before its first computation. "
            "Import granjax, or call granjax.tune(), before computing with JAX.",
        )
    if wanted:
        os.environ["XLA_FLAGS"] = flags = " ".join([*wanted, flags]).strip()
        return Tuning(flags, True, f"Set {' '.join(wanted)}.")
    if _applied is None and _started_before_import:
        return Tuning(flags, True, "Set by the user before JAX started.")
    return Tuning(flags, True, "In force already.")


_applied = None
_started_before_import = False


def prepare_import():
    """What `import granjax` does first: float64 unless the user has chosen, and the XLA flags."""
    global _applied, _started_before_import
    import jax

    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)
    _started_before_import = _started()
    if os.environ.get("GRANJAX_TUNE", "1") != "0":
        _applied = tune()
