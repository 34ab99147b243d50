"""The command line."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import matplotlib.image
import numpy as np
import pytest
import xarray as xr

import granjax as gx
from granjax.cli import main, pages
from granjax.cli.commands import _parser
from granjax.work_precision import Ladder, measure

SMALL = ["resonance", "--beads", "11", "--ratios", "12"]


def command(*arguments, cwd, **environment):
    """`python -m granjax` in a fresh process."""
    return subprocess.run(
        [sys.executable, "-m", "granjax", *arguments], capture_output=True, text=True, cwd=cwd,
        env={**os.environ, **environment}, check=False,
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
        np.testing.assert_array_equal(data["mass_ratio"], result["mass_ratio"])
        np.testing.assert_array_equal(data["transmission"], result["transmission"])
        np.testing.assert_array_equal(data["resonances"], result["resonances"])
        assert data.attrs["beads"] == 11
        assert data.attrs["granjax_version"] == gx.__version__
        assert "monomer" in data.attrs["definition"]
        assert "A = 1" in data.attrs["units"]


@pytest.mark.study
def test_the_command_makes_a_device_of_every_core(tmp_path):
    code = (
        "import jax; from granjax.cli.commands import _cores, _prepare; _prepare(False); "
        "print(jax.device_count() == _cores())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "JAX_NUM_CPU_DEVICES"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
    )
    assert done.stdout.strip() == "True", done.stderr


@pytest.mark.study
def test_compiled_programs_are_kept_unless_asked_not_to(tmp_path):
    kept, none = tmp_path / "kept", tmp_path / "none"
    for place, switch in ((kept, ()), (none, ("--no-cache",))):
        done = command(*switch, *SMALL, cwd=tmp_path, GRANJAX_CACHE=str(place))
        assert done.returncode == 0 and done.stderr == "", done.stderr
    assert any(path.is_file() for path in kept.rglob("*")) and not none.exists()
    assert command(*SMALL, cwd=tmp_path, GRANJAX_CACHE=str(kept)).stderr == "", "what is read back brings no warning"


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
        (["resonance", "--out", "FILE/folder"], "--out: expected a folder that can be made and written"),
        (["resonance", "--bead-count", "2"], "unrecognized arguments"),
        (["sing"], "invalid choice: 'sing'"),
        (["reproduce"], "FIGURE: expected labels of figures, or --all, got neither."),
        (["reproduce", "fig1.33"], "Did you mean"),
        (["reproduce", "fig1.3", "--set", "sites"], "--set: expected NAME=VALUE"),
        (["bench", "--repeats", "0"], "--repeats: expected a whole number not below 1, got 0."),
        (["bench", "--out", "FILE/folder"], "--out: expected a folder that can be made and written"),
        (["bench", "no such scene"], "SCENE: expected one of"),
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


@pytest.mark.study
def test_bad_input_from_a_shell(tmp_path):
    done = command("resonance", "--beads", "2", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("granjax: --beads")
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_computation_that_fails_is_code_1(tmp_path, monkeypatch, capsys):
    def fail(*arguments, **keywords):
        raise RuntimeError("It did not complete.")

    monkeypatch.setattr(gx.resonance, "transmission", fail)
    assert main([*SMALL, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert "granjax: It did not complete." in said and page_named_in(said) == pages.OUTCOMES


def test_version_and_help(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"granjax {gx.__version__}\n"
    assert main([]) == 0
    out = capsys.readouterr().out
    assert "resonance" in out and "reproduce" in out


COMMANDS = ("resonance", "sweep", "reproduce", "bench")


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
    assert 24 <= len(lines) <= 40
    examples = [shlex.split(line) for line in lines if line.startswith(" " * 10 + "        granjax ")]
    assert [example[1] for example in examples] == list(COMMANDS)
    assert all(f"  {name} " in "\n".join(lines) for name in COMMANDS)
    assert page_named_in("\n".join(lines)) == pages.START


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_ends_with_examples_and_a_page(name, monkeypatch, capsys):
    lines = help_of(monkeypatch, capsys, name)
    assert page_named_in(lines[-1]) in titles()
    examples = lines[lines.index("examples:") + 1 : -2]
    assert 1 <= len(examples) <= 2
    for line in examples:
        arguments = _parser().parse_args(shlex.split(line)[1:])
        assert arguments.page == page_named_in(lines[-1])


def test_pages_that_are_named_exist():
    named = {title for name, title in vars(pages).items() if name.isupper()}
    assert len(named) == 6 and named <= titles()


def test_an_error_names_the_page_that_explains_it(tmp_path, capsys):
    file = tmp_path / "a.toml"
    file.write_text("[scene]\nkind = 'dimer'\nsites = 8\n[vary]\nratio = [0.5, 1.0]\n[run]\nuntil = 2\n"
                    "[record]\nlast = {kind = 'final', of = 'energy'}\n[start]\nkind = 'impact'\n")
    begun = tmp_path / "b.nc.chunks"
    begun.mkdir()
    stored = tmp_path / "b.toml"
    stored.write_text(file.read_text() + "[result]\nstore = 'b.nc'\n")
    cases = {
        ("sweep", "none.toml"): pages.FILE, ("sweep", str(file), "--nothing"): pages.FILE,
        ("sweep", str(file), "--resume"): pages.RESUME, ("sweep", str(file), "--workers", "9999"): pages.CLUSTER,
        ("sweep", str(stored), "--out", str(tmp_path)): pages.RESUME, ("bench", "nowhere"): pages.METHOD,
        ("resonance", "--beads", "x"): pages.START, ("sing",): pages.START,
    }
    for arguments, page in cases.items():
        assert main([*arguments]) == 2
        assert page_named_in(capsys.readouterr().err) == page, arguments


def test_reproduce_lists_the_figures(capsys):
    assert main(["reproduce", "--list"]) == 0
    assert gx.reproduce.listing() in capsys.readouterr().out


class Outcome:
    """Stands for a result of `reproduce.run`."""

    def __init__(self, passed, failure=""):
        self.passed, self.failure, self.unwritten = passed, failure, ""

    def __str__(self):
        return f"figure, passed: {self.passed}"


@pytest.mark.parametrize(
    "arguments, asked, outcome, code",
    [
        (["fig1.3"], (["fig1.3"], ".", False), Outcome(None), 0),
        (["--all", "--check"], (None, None, True), Outcome(True), 0),
        (["fig1.3", "--check", "--out", "X"], (["fig1.3"], "X", True), Outcome(False), 1),
        (["fig1.3"], (["fig1.3"], ".", False), Outcome(None, "It failed."), 1),
    ],
)
def test_reproduce_passes_its_arguments_on(arguments, asked, outcome, code, monkeypatch, capsys):
    seen = []

    def run(labels, out, check, plots, overrides):
        seen.append((labels, out, check))
        assert plots is gx.plots
        assert overrides == {"sites": "9"}
        return [outcome]

    monkeypatch.setattr(gx.reproduce, "one_by_one", run)
    assert main(["reproduce", *arguments, "--set", "sites=9"]) == code
    assert seen == [asked]
    assert str(outcome) in capsys.readouterr().out


class Scene(NamedTuple):
    """Stands for a canonical scene."""

    name: str
    title: str = "A scene of the tests"
    lattice: object = "lattice"
    state: object = "state"
    t0: float = 1.0
    t1: float = 2.0
    reference: object = None
    uncertainty: float = 1e-13
    tangents: bool = False


def measured(*scene, **keywords):
    """A small table, in place of `gx.work_precision`; `t1` below `t0` is chaos."""
    if scene[2] < keywords["t0"]:
        raise RuntimeError("No reference exists.")

    def call(step):
        return (np.array([1 + step**2]), np.ones(1)), 1 / step, 1 / step

    ladder = Ladder("method", "step", [0.08, 0.01, 0.001], call)
    return measure([ladder], (np.ones(1), np.ones(1)), 1e-12, keywords["repeats"])


@pytest.fixture
def bench(monkeypatch, tmp_path, capsys):
    """`granjax bench` on scenes of one's own: exit code, output, files, and what `work_precision` was asked for."""
    def run(scenes, *arguments):
        asked = []

        def work_precision(*scene, **keywords):
            asked.append((scene, keywords))
            return measured(*scene, **keywords)

        by_name = {scene.name: scene for scene in scenes}
        monkeypatch.setattr(gx, "canonical", SimpleNamespace(names=lambda: tuple(by_name), scene=by_name.get), False)
        monkeypatch.setattr(gx, "work_precision", work_precision)
        # what it says of flags and cores depends on what this process has computed before
        monkeypatch.setattr("granjax.cli.commands._prepare", lambda cache: None)
        code = main(["bench", "--out", str(tmp_path), *arguments])
        return code, capsys.readouterr(), sorted(path.name for path in tmp_path.iterdir()), asked

    return run


def test_bench_writes_a_chart_and_a_table_for_every_scene(bench, tmp_path):
    scenes = Scene("one"), Scene("two", reference="exact", uncertainty=1e-12, tangents=True)
    code, printed, files, asked = bench(scenes)
    own = {"t0": 1.0, "repeats": 5}
    assert code == 0
    assert files == ["bench-one.json", "bench-one.png", "bench-two.json", "bench-two.png"]
    assert asked == [
        (("lattice", "state", 2.0), {**own, "reference": None, "uncertainty": None, "tangents": False}),
        (("lattice", "state", 2.0), {**own, "reference": "exact", "uncertainty": 1e-12, "tangents": True}),
    ]
    assert "one: A scene of the tests" in printed.out and "method, order 2.00" in printed.out
    assert "For 0.0001: method, step" in printed.out
    assert matplotlib.image.imread(tmp_path / "bench-one.png").shape[2] in (3, 4)
    data = json.loads((tmp_path / "bench-two.json").read_text())
    assert data["scene"] == "two" and data["t1"] == 2.0 and data["machine"]["jax"]
    assert gx.WorkPrecision.from_json(data).methods == ("method",)


def test_bench_of_some_scenes_as_json(bench):
    code, printed, files, asked = bench([Scene("one"), Scene("two")], "two", "--json", "--repeats", "2")
    assert code == 0 and files == ["bench-two.json", "bench-two.png"]
    assert set(json.loads(printed.out)) == {"two"}
    assert [keywords["repeats"] for _, keywords in asked] == [2]


def test_bench_goes_on_after_a_scene_that_fails(bench):
    code, printed, files, _ = bench([Scene("chaos", t1=0.5), Scene("fine")])
    assert code == 1 and files == ["bench-fine.json", "bench-fine.png"]
    assert "chaos: No reference exists." in printed.err


def test_bench_lists_the_scenes(bench):
    code, printed, files, asked = bench([Scene("one"), Scene("two")], "--list")
    assert code == 0 and not files and not asked
    assert [line.split()[0] for line in printed.out.splitlines()] == ["one", "two"]


NAMES = ("slow", "quick", "middle")


@pytest.fixture
def timed(monkeypatch, bench):
    """`granjax bench` on three scenes of known cost, on a clock that stands still unless a scene is measured."""
    from granjax.cli import bench as module

    def run(*arguments, pace=1.0, limit=120.0):
        now = [0.0]
        cost = {"slow": 500.0, "quick": 10.0, "middle": 40.0}
        monkeypatch.setattr(module, "SECONDS", cost)
        monkeypatch.setattr(module, "LIMIT", limit)
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
        took = module._measured

        def measure(scene, repeats):
            now[0] += pace * cost[scene.name]
            return took(scene, repeats)

        monkeypatch.setattr(module, "_measured", measure)
        found = bench([Scene(name) for name in NAMES], *arguments)
        monkeypatch.setattr(module, "_measured", took)
        return found

    return run


def test_bench_says_what_it_takes_and_runs_the_quick_scenes_first(timed):
    code, printed, files, asked = timed()
    assert code == 0 and files[::2] == ["bench-middle.json", "bench-quick.json"] and len(asked) == 2
    assert printed.err.splitlines() == [
        "granjax: 2 scenes, about 50 s: quick, middle. More if there is time; all 3 take 9 min: --all.",
        "granjax: quick (1 of 2), 0 s gone, about 50 s left", "granjax: middle (2 of 2), 10 s gone, about 40 s left",
        "granjax: 50 s gone, and no time for slow: --all, or names.",
    ]
    assert printed.out.index("quick:") < printed.out.index("middle:")


@pytest.mark.slow
def test_bench_ends_within_its_time_on_a_slow_machine_and_does_more_on_a_fast_one(timed):
    code, printed, files, _ = timed(pace=4.0)
    assert code == 0 and len(files) == 2 and "quick" in files[0]
    assert printed.err.splitlines()[-1] == "granjax: 40 s gone, and no time for middle, slow: --all, or names."
    code, printed, files, _ = timed(pace=0.1)
    assert code == 0 and len(files) == 6 and "slow (3 of 3), 5 s gone, about 50 s left" in printed.err


@pytest.mark.slow
def test_bench_of_all_scenes_has_no_limit(timed):
    code, printed, files, _ = timed("--all", pace=4.0)
    assert code == 0 and len(files) == 6
    assert printed.err.splitlines()[0] == "granjax: 3 scenes, about 9 min: quick, middle, slow."
    assert "slow (3 of 3), 3 min gone, about 33 min left" in printed.err
    assert timed("slow", "quick")[0] == 0
    assert timed("slow", "--all")[0] == 2
    listed = timed("--list")[1].out.splitlines()
    assert [line.split()[:3] for line in listed][0] == ["quick", "10", "s"] and len(listed) == 3
