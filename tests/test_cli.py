"""The command line."""

import os
import signal
import subprocess
import sys
import time

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

import granjax as gx
from granjax.__main__ import main

SMALL = ["resonance", "--beads", "11", "--ratios", "12"]


@pytest.mark.slow
def test_resonance_from_a_shell(tmp_path):
    """In a process of its own, from whose devices every core takes a share."""
    code = "import jax, sys; from granjax.__main__ import main; main(sys.argv[1:]); print(jax.device_count())"
    kept = tmp_path / "kept"
    own = {k: v for k, v in os.environ.items() if k not in ("JAX_NUM_CPU_DEVICES", "XLA_FLAGS")}
    done = subprocess.run(
        [sys.executable, "-c", code, *SMALL, "--out", str(tmp_path / "made" / "here")],
        capture_output=True,
        text=True,
        env={**own, "GRANJAX_CACHE": str(kept)},
        check=False,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert "Dimer chain of 11 beads and a wall, 12 mass ratios." in done.stdout
    assert "0.3428" in done.stdout and "asymptotic" in done.stdout
    assert done.stdout.splitlines()[-1] == str(len(os.sched_getaffinity(0)))
    assert any(path.is_file() for path in kept.rglob("*"))
    place = tmp_path / "made" / "here"
    assert sorted(path.name for path in place.iterdir()) == ["resonance.nc", "resonance.png"]
    assert matplotlib.image.imread(place / "resonance.png").shape[2] in (3, 4)
    with xr.open_dataset(place / "resonance.nc", engine="h5netcdf") as data:
        np.testing.assert_allclose(data["mass_ratio"], np.linspace(0.05, 1, 13)[1:])
        assert data["transmission"][-1] == 1.0 and data.attrs["beads"] == 11
        assert data.attrs["granjax_version"] == gx.__version__
        assert "monomer" in data.attrs["definition"] and "A = 1" in data.attrs["units"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["resonance", "--beads", "2"], "--beads: expected a whole number not below 3, got 2."),
        (["resonance", "--ratios", "2"], "--ratios: expected a whole number not below 3, got 2."),
        (["resonance", "--beads", "many"], "invalid int value: 'many'"),
        (["resonance", "--out", "FILE/folder"], "--out: expected a folder that can be created"),
        (["resonance", "--bead-count", "2"], "unrecognized arguments"),
        (["sing"], "invalid choice: 'sing'"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(arguments, message, tmp_path, capsys):
    (tmp_path / "FILE").write_text("not a folder")
    arguments = [a.replace("FILE", str(tmp_path / "FILE")) for a in arguments]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and message in printed.err.splitlines()[-1]


def test_version_and_help(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"granjax {gx.__version__}\n"
    assert main([]) == 0
    assert "resonance" in capsys.readouterr().out


def test_help_says_what_is_chosen_without_options(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["resonance", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert stop.value.code == 0
    assert "beads of the chain, 3 or more (101)" in said
    assert "mass ratios in (0.05, 1], 3 or more (200)" in said


LONG_RUN = """
import granjax as gx
chain = gx.scenes.monomer(200)
print("ready", flush=True)
gx.simulate(chain, gx.states.impact(chain), 1e5, step=0.001)
"""


@pytest.mark.slow
def test_an_interrupt_ends_what_takes_long(tmp_path):
    # whatever started the tests may ignore the signal
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        script = subprocess.Popen(
            [sys.executable, "-c", LONG_RUN],
            cwd=tmp_path,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert script.stdout.readline() == "ready\n"
    time.sleep(6.0)
    assert script.poll() is None
    script.send_signal(signal.SIGINT)
    told = script.communicate(timeout=60)[1].splitlines()
    assert script.returncode == -signal.SIGINT
    assert told[-1].startswith("KeyboardInterrupt: simulate was interrupted at t = ")
