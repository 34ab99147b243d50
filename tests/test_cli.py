"""The command line."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

import granjax as gx
from granjax.cli import OUTCOMES, START, _parser, main

SMALL = ["resonance", "--beads", "11", "--ratios", "12"]


def command(*arguments, cwd, **environment):
    """`python -m granjax` in a fresh process."""
    return subprocess.run(
        [sys.executable, "-m", "granjax", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, **environment},
        check=False,
    )


@pytest.mark.study
def test_resonance_from_a_shell(tmp_path):
    done = command(*SMALL, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert set(result) == {"mass_ratio", "transmission", "resonances", "anti_resonances"}
    np.testing.assert_allclose(result["mass_ratio"], np.linspace(0.05, 1, 13)[1:])
    assert result["transmission"][-1] == 1.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["resonance.nc", "resonance.png"]
    assert matplotlib.image.imread(tmp_path / "resonance.png").shape[2] in (3, 4)
    with xr.open_dataset(tmp_path / "resonance.nc", engine="h5netcdf") as data:
        assert_array_equal(data["mass_ratio"], result["mass_ratio"])
        assert_array_equal(data["transmission"], result["transmission"])
        assert_array_equal(data["resonances"], result["resonances"])
        assert data.attrs["beads"] == 11
        assert data.attrs["granjax_version"] == gx.__version__
        assert "monomer" in data.attrs["definition"]
        assert "A = 1" in data.attrs["units"]


@pytest.mark.study
def test_the_command_makes_a_device_of_every_core(tmp_path):
    code = (
        "import jax; from granjax.cli import _prepare; from granjax.tuning import cores; _prepare(False); "
        "print(jax.device_count() == cores())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "JAX_NUM_CPU_DEVICES"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        check=False,
    )
    assert done.stdout.strip() == "True", done.stderr


@pytest.mark.study
def test_compiled_programs_are_kept_unless_asked_not_to(tmp_path):
    kept, none = tmp_path / "kept", tmp_path / "none"
    for place, switch in ((kept, ()), (none, ("--no-cache",))):
        done = command(*switch, *SMALL, cwd=tmp_path, GRANJAX_CACHE=str(place))
        assert done.returncode == 0 and done.stderr == "", done.stderr
    assert any(path.is_file() for path in kept.rglob("*")) and not none.exists()
    assert command(*SMALL, cwd=tmp_path, GRANJAX_CACHE=str(kept)).stderr == "", (
        "what is read back brings no warning"
    )


@pytest.mark.study
def test_resonance_prints_a_table(tmp_path, capsys):
    assert main([*SMALL, "--out", str(tmp_path / "made" / "here")]) == 0
    out = capsys.readouterr().out
    assert "Dimer chain of 11 beads and a wall, 12 mass ratios." in out
    assert "0.3428" in out and "asymptotic" in out
    assert (tmp_path / "made" / "here" / "resonance.png").is_file()


@pytest.mark.slow
def test_out_may_name_the_files(tmp_path):
    assert main([*SMALL, "--json", "--out", str(tmp_path / "other.nc")]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.nc", "other.png"]


def titles():
    """Of the pages of the documentation."""
    docs = Path(__file__).parents[1] / "docs"
    return {page.read_text().partition("\n")[0].removeprefix("# ") for page in docs.rglob("*.md")}


def page_named_in(text):
    """The one page that a text names."""
    (title,) = re.findall(r"See the page '([^']+)'", text)
    return title


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["resonance", "--beads", "2"], "--beads: expected a whole number not below 3, got 2."),
        (["resonance", "--ratios", "2"], "--ratios: expected a whole number not below 3, got 2."),
        (["resonance", "--beads", "many"], "invalid int value: 'many'"),
        (["resonance", "--out", "FILE/folder"], "--out: expected a folder that can be made"),
        (["resonance", "--bead-count", "2"], "unrecognized arguments"),
        (["sing"], "invalid choice: 'sing'"),
        (["reproduce"], "invalid choice: 'reproduce'"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(arguments, message, tmp_path, capsys):
    (tmp_path / "FILE").write_text("not a folder")
    arguments = [a.replace("FILE", str(tmp_path / "FILE")) for a in arguments]
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    complaint = [line for line in printed.err.splitlines() if "JAX has started" not in line]
    assert len(complaint) == 1
    assert message in complaint[0]
    assert page_named_in(complaint[0]) in titles()


def test_a_computation_that_fails_is_code_1(tmp_path, monkeypatch, capsys):
    def fail(*arguments, **keywords):
        raise RuntimeError("It did not complete.")

    monkeypatch.setattr(gx.resonance, "transmission", fail)
    assert main([*SMALL, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert "granjax: It did not complete." in said and OUTCOMES in said


def test_version_and_help(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"granjax {gx.__version__}\n"
    assert main([]) == 0
    assert "resonance" in capsys.readouterr().out


def help_of(monkeypatch, capsys, *command):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    lines = capsys.readouterr().out.rstrip("\n").split("\n")
    assert max(map(len, lines)) <= 80
    return lines


def test_help_is_one_screenful_with_an_example_of_every_command(monkeypatch, capsys):
    lines = help_of(monkeypatch, capsys)
    assert len(lines) <= 40
    examples = [
        shlex.split(line) for line in lines if line.startswith(" " * 10 + "        granjax ")
    ]
    assert [example[1] for example in examples] == ["resonance"]
    assert START in "\n".join(lines)


def test_help_of_the_command_ends_with_examples_and_a_page(monkeypatch, capsys):
    lines = help_of(monkeypatch, capsys, "resonance")
    assert lines[-1] == START
    examples = lines[lines.index("examples:") + 1 : -2]
    assert 1 <= len(examples) <= 2
    for line in examples:
        assert _parser().parse_args(shlex.split(line)[1:]).command


COMMAND = """
import sys
from granjax.cli import command
print("ready", flush=True)
sys.argv = ["granjax", "resonance", "--beads", "301", "--ratios", "2000"]
command()
"""
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
        command, script = (
            subprocess.Popen(
                [sys.executable, "-c", code],
                cwd=tmp_path,
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
            for code in (COMMAND, LONG_RUN)
        )
    finally:
        signal.signal(signal.SIGINT, before)
    both = command, script
    assert [process.stdout.readline() for process in both] == ["ready\n"] * 2
    time.sleep(10.0)
    assert [process.poll() for process in both] == [None] * 2
    for process in both:
        process.send_signal(signal.SIGINT)
    said, told = (process.communicate(timeout=60)[1].splitlines() for process in both)
    assert (command.returncode, script.returncode) == (130, -signal.SIGINT)
    assert not [*tmp_path.iterdir()] and said == ["granjax: interrupted"]
    assert told[-1].startswith("KeyboardInterrupt: simulate was interrupted at t = ")
