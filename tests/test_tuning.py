"""What import sets, in fresh processes."""

import json
import os
import subprocess
import sys

import pytest

REPORT = """
import json, os, sys
{before}
import granjax as gx
import jax, jax.numpy as jnp
tuning = gx.tune()
print(json.dumps([tuning.flags, tuning.complete, tuning.message, str(jnp.zeros(()).dtype)]))
"""


def report(before="", **environment):
    names = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "GRANJAX_TUNE", "JAX_ENABLE_X64")}
    done = subprocess.run(
        [sys.executable, "-c", REPORT.format(before=before)], capture_output=True, text=True, check=True,
        env=names | environment,
    )
    return json.loads(done.stdout)


def test_import_sets_the_flags_and_float64():
    flags, complete, _, dtype = report()
    assert "xla_cpu_small_while_loop_byte_threshold" in flags and complete
    assert dtype == "float64"


def test_the_environment_turns_both_off():
    flags, _, _, dtype = report(
        before="import jax; jax.numpy.zeros(()).block_until_ready()", GRANJAX_TUNE="0", JAX_ENABLE_X64="0"
    )
    assert flags == "" and dtype == "float32"


def test_too_late_is_said():
    _, complete, message, _ = report(before="import jax; jax.numpy.zeros(()).block_until_ready()")
    assert not complete and "before its first computation" in message


OWN = ("--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=7", "bare_word=1")


@pytest.mark.parametrize("own", OWN)
def test_what_the_user_set_stays(own):
    flags, complete, _, _ = report(XLA_FLAGS=own)
    assert own in flags and complete
    if own == "bare_word=1":
        assert flags.endswith(own), "granjax's flags go in front of a bare word"
    else:
        assert flags.count("xla_backend_extra_options") == 1
