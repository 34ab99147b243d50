"""Sweeps that stand in TOML files."""

import os
import re
import time
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import granjax as gx
from granjax.cli import main
from granjax.exchange import datasets
from granjax.sweeps.file import recipe
from granjax.sweeps.file.recipe import SOLVERS, recipe_of
from granjax.sweeps.file.records import QUANTITIES, REST, RUN
from granjax.sweeps.file.scene import SCENES, STARTS
from granjax.sweeps.file.text import parsed

MAP = """
title = "What passes"

[scene]
kind = "dimer"
sites = 8

[start]
kind = "impact"
velocity = 1.0

[vary]
ratio = {from = 0.4, to = 1.0, count = 3}
precompression = {from = 1e-3, to = 1e-1, count = 2, scale = "log"}

[run]
until = {per_bead = 1.5, plus = 3}

[record]
force = {kind = "peak", of = "contact_force", bond = -1}
through = {kind = "peak", of = "contact_force", bond = -1, relative_to = {ratio = 1.0}}
when = {kind = "arrival", of = "contact_force", bond = 4, threshold = 0.2}
deepest = {kind = "lowest", of = "velocity"}
pushed = {kind = "integral", of = "contact_force", bond = -1}
last = {kind = "final", of = "energy"}
cutoff = {kind = "upper_edge", band = -1}

[result]
store = "map.nc"
picture = "map.png"
show = "through"
table = "map.csv"
chunk = 8
"""
CRYSTAL = """
[materials."hard glass"]
young = 72e9
poisson = 0.22
density = 2500

[scene]
kind = "beads"
materials = ["hard glass", "steel 316", "PTFE"]
radii = [9e-3, 8e-3, 7e-3]
precompression = 10
cells = 3
boundary = "periodic"

[vary]
"radii[0]" = [6e-3, 9e-3]
"radii[2]" = [6e-3, 7e-3, 8e-3]

[record]
gap_from = {kind = "upper_edge", band = 0, unit = "kHz"}
gap_to = {kind = "lower_edge", band = 1, unit = "kHz"}
sound = {kind = "sound_speed"}
"""
WORDS = """
[scene]
kind = "n_to_one"
sites = 12
beads = 2
units = "SI"
[start]
kind = "random"
[vary]
beads = [2, 3]
boundary = ["fixed", "free"]
start.seed = [1, 2]
[design]
kind = "paired"
[run]
until = 2
solver = "SRKN6b"
step = 0.05
[record]
most = {kind = "peak", of = "displacement", site = 0, unit = "mm"}
"""
RANDOM = """
[scene]
kind = "defects"
sites = 9
masses = {4 = 0.5}
precompression = 0.1
[vary]
"masses[4]" = {from = 0.1, to = 10, scale = "log"}
stiffness = {from = 1, to = 2}
[design]
kind = "random"
count = 5
seed = 3
[record]
modes = {kind = "mode_frequency"}
"""
ALL = {"map": MAP, "crystal": CRYSTAL, "words": WORDS, "random": RANDOM}


def of(text):
    return recipe_of(parsed(text.encode()))


def changed(text, old, new):
    assert old in text
    return text.replace(old, new)


def refused(text):
    with pytest.raises(ValueError) as caught:
        of(text).check()
    return str(caught.value)


@pytest.mark.parametrize("text", ALL.values(), ids=ALL)
def test_a_file_is_read_and_looked_at(text):
    made = of(text)
    made.check()
    assert made == made and made.function == of(text).function and hash(made.function) == hash(of(text).function)
    assert f"{made.parameters.count} lanes" in str(made)


def test_the_file_of_the_readme_is_one():
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    made = of(re.search(r"^```toml\n(.*?)^```", readme, re.M | re.S)[1])
    made.check()
    assert made.parameters.count == 288 and made.units["speed"] == "mm/s"


def test_what_varies():
    points = of(MAP).parameters
    np.testing.assert_allclose(points.axes["ratio"], [0.4, 0.7, 1.0], rtol=1e-15)
    np.testing.assert_allclose(points.axes["precompression"], [1e-3, 1e-1], rtol=1e-14)
    assert points.design == "grid" and points.count == 6
    assert of(MAP).units == {}
    assert set(of(CRYSTAL).parameters.axes) == {"radii_0", "radii_2"}
    assert of(CRYSTAL).units == {
        "radii_0": "m", "radii_2": "m", "gap_from": "kHz", "gap_to": "kHz", "sound": "1/s"}
    points = of(WORDS).parameters
    assert {name: x.tolist() for name, x in points.axes.items()} == {
        "beads": [2, 3], "boundary": ["fixed", "free"], "start_seed": [1, 2]}
    axes = of(RANDOM).parameters.axes
    assert len(axes["masses_4"]) == 5 and 0.1 <= axes["masses_4"].min() and axes["stiffness"].max() <= 2


@pytest.mark.slow
def test_several_places_and_ends_of_runs():
    text = changed(TINY, "bond = -1}", "bond = [1, -1]}").partition("through =")[0]
    text = changed(text, "ratio = {from = 0.5, to = 1.0, count = 3}", "run.until = [3, 13]")
    made = of(changed(text, "until = {per_bead = 1.5, plus = 4}", ""))
    made.check()
    assert made.parameters.axes["run_until"].tolist() == [3.0, 13.0]
    force = np.array([made.function(run_until=end)["force"] for end in (3.0, 13.0)])
    assert force.shape == (2, 2) and force[0, 1] < force[1, 1] and force[0, 0] > 0.3
    assert "numbers above zero, got -3" in refused(changed(text, "[3, 13]", "[-3, 13]"))


def test_whole_numbers_stay_whole():
    text = changed(MAP, "ratio = {from = 0.4, to = 1.0, count = 3}", "sites = {from = 4, to = 9, count = 3}")
    row = of(changed(text, "{ratio = 1.0}", "{sites = 4}")).parameters.axes["sites"]
    assert row.tolist() == [4, 6, 9] and row.dtype.kind == "i"


def test_materials_of_the_file_are_used():
    lattice = of(CRYSTAL).function.lattice({})
    np.testing.assert_allclose(lattice.mass[0], gx.materials.bead_mass(
        gx.materials.Material("glass", 72e9, 0.22, 2500.0), 9e-3), rtol=1e-14)


def test_frequencies_come_in_the_unit_that_is_asked_for():
    made = of(CRYSTAL)
    values = {"radii_0": 9e-3, "radii_2": 7e-3}
    found = made.function(**values)
    chain = gx.scenes.beads(
        [gx.materials.Material("glass", 72e9, 0.22, 2500.0), "steel 316", "PTFE"],
        [values["radii_0"], 8e-3, values["radii_2"]], 10.0, cells=3, boundary="periodic")
    bands = gx.linear.bands(chain)
    np.testing.assert_allclose(found["gap_from"], bands.upper[0] / (2e3 * np.pi), rtol=1e-12)
    np.testing.assert_allclose(found["gap_to"], bands.lower[1] / (2e3 * np.pi), rtol=1e-12)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("[scene]", "[scenes]", "one of title, materials, scene, start, vary, design, run, record, result, got 'scenes'"
         ". Did you mean 'scene'?"),
        ('kind = "dimer"', 'kind = "dimmer"', "[scene] kind: expected one of"),
        ('kind = "dimer"', 'kind = ["dimer"]', "[scene] kind: expected one of"),
        ('kind = "dimer"', "", "[scene] kind: expected a value, got none"),
        ("sites = 8", "", "[scene] sites: expected a value, which 'dimer' needs, got none"),
        ("sites = 8", "sites = 8.5", "[scene] sites: expected a whole number"),
        ("sites = 8", "sites = 10000000000", "[scene] sites: expected a whole number within 1 ... 10000000"),
        ("sites = 8", "sites = true", "[scene] sites: expected a whole number"),
        ("sites = 8", "sites = 1979-05-27", "[scene] sites: expected a whole number"),
        ("sites = 8", "site = 8", "Did you mean 'sites'?"),
        ("sites = 8", "sites = 8\nexponent = nan", "[scene] exponent: expected a finite number, got nan"),
        ("sites = 8", "sites = 8\nexponent = inf", "[scene] exponent: expected a finite number, got inf"),
        ("sites = 8", f"sites = 8\nexponent = {10**400}", "[scene] exponent: expected a finite number"),
        ("sites = 8", "sites = 8\nexponent = [[]]", "[scene] exponent[0]: expected a list of some values"),
        ("sites = 8", 'sites = 8\nboundary = "open"', "boundary: expected one of"),
        ("velocity = 1.0", "velocty = 1.0", "Did you mean 'velocity'?"),
        ("ratio = {from", "start.sit = {from", "Did you mean 'start.site'?"),
        ("ratio = {from", "ration = {from", "[vary]: expected one of"),
        ("ratio = {from", '"ratio[0]" = {from', "an element of a list [scene] ratio"),
        ("from = 0.4", "form = 0.4", "Did you mean 'from'?"),
        ("count = 3", "count = 0", "[vary] ratio count: expected a whole number within 1 ... 1000000, got 0"),
        ("count = 3", "count = 99999999", "[vary] ratio count: expected a whole number"),
        ("{from = 0.4, to = 1.0, count = 3}", "[]", "[vary] ratio: expected a list of some values"),
        ("{from = 0.4, to = 1.0, count = 3}", "0.4", "What does not vary belongs into [scene]"),
        ("{from = 0.4, to = 1.0, count = 3}", '["a"]', "[vary] ratio[0]: expected a number, got 'a'"),
        ("{from = 0.4, to = 1.0, count = 3}", "[0.5, 0.5]", "[vary] ratio: expected different values"),
        ("{from = 0.4, to = 1.0, count = 3}", "[0.5, nan]", "[vary] ratio[1]: expected a finite number, got nan"),
        ("{from = 0.4, to = 1.0, count = 3}", "[0.5, -0.5]", "[scene] at ratio = -0.5"),
        ("from = 1e-3", "from = 0", "above zero on a logarithmic scale"),
        ("from = 0.4, to = 1.0", "from = 1.0, to = 1.0", "from and to that differ"),
        ("from = 0.4, to = 1.0", "from = -1e308, to = 1e308", "whose difference is a number"),
        ("per_bead = 1.5", "per_site = 1.5", "one of per_bead, plus"),
        ("until = {per_bead = 1.5, plus = 3}", "until = -3", "[run] until: expected a number above zero"),
        ("until = {per_bead = 1.5, plus = 3}", "until = 3\nstep = 0.1\ntolerance = 1e-8", "a tolerance or a step"),
        ("until = {per_bead = 1.5, plus = 3}", 'until = 3\nsolver = "RKN87"', "Did you mean 'RKN86'"),
        ('kind = "peak"', 'kind = "peek"', "Did you mean 'peak'"),
        ('of = "velocity"', 'of = "speed"', "[record.deepest] of: expected one of"),
        ("bond = 4", "bond = 99", "[record.when] bond: expected an index within -9 ... 8, got 99"),
        ("bond = 4", "site = 4", "[record.when]: expected one of"),
        (", threshold = 0.2", "", "[record.when] threshold: expected a value"),
        ("{ratio = 1.0}", "{ratoi = 1.0}", "Did you mean 'ratio'?"),
        ("{ratio = 1.0}", "{}", "[record.through] relative_to: expected values of the scene's arguments"),
        ("bond = 4, ", 'bond = 4, unit = "ms", ', "none for scaled numbers, got 'ms'"),
        ("last =", "reason =", "none of lane, reason, outcome"),
        ("last =", "ratio =", "[record] ratio: expected a name of its own"),
        ("last =", '"a b" =', "names of letters, digits and underscores"),
        ('store = "map.nc"', 'store = "../map.nc"', "[result] store: expected a file's name without folders"),
        ('store = "map.nc"', 'store = "/tmp/map.nc"', "[result] store: expected a file's name without folders"),
        ('store = "map.nc"', 'store = "map.pkl"', "[result] store: expected a name ending in .nc"),
        ('show = "through"', 'show = "throu"', "Did you mean 'through'?"),
        ("chunk = 8", "chunk = 0", "[result] chunk: expected a whole number"),
        ("chunk = 8", "chunks = 8", "Did you mean 'chunk'?"),
        ("[result]", "[design]\nkind = 'radnom'\n[result]", "Did you mean 'random'"),
        ("[result]", "[design]\nseed = 1\n[result]", "[design]: expected one of kind"),
        ("[result]", "[design]\nkind = 'paired'\n[result]", "lists of one length"),
        ("[result]", "[result", "FILE: it is no TOML"),
        ("title = ", "title = 3 #", "title: expected a word, got 3"),
        ("[start]", "[starts]", "Did you mean 'start'?"),
    ],
)
def test_what_cannot_be_meant_is_a_sentence_with_its_place(old, new, message):
    assert message in refused(changed(MAP, old, new))


def test_too_many_combinations_are_refused():
    text = changed(changed(MAP, "count = 3", "count = 1000000"), "count = 2", "count = 1000")
    assert "[vary]: expected at most 10000000 combinations, got 1000000000" in refused(text)


@pytest.mark.parametrize(
    "text, old, new, message",
    [
        (CRYSTAL, 'unit = "kHz"', 'unit = "kHertz"', "[record.gap_from] unit: expected the name of a unit"),
        (CRYSTAL, 'unit = "kHz"', 'unit = "mm"', "[record.gap_from] unit: expected one of 'rad/s', got 'mm'"),
        (CRYSTAL, '"PTFE"]', '"PTFF"]', "[scene] at radii_0 = 0.006, radii_2 = 0.006: materials[2]"),
        (CRYSTAL, "young = 72e9", "young = -1.0", "[materials.hard glass] young: expected numbers above zero"),
        (CRYSTAL, "young = 72e9", "", "[materials.hard glass] young: expected a value"),
        (CRYSTAL, '"radii[2]"', '"radii[3]"', "[vary] radii[3]: expected an element of a list [scene] radii"),
        (CRYSTAL, '"radii[2]"', '"radii[0] "', "[vary]: expected one of"),
        (CRYSTAL, "[record]", "[run]\nuntil = 3\n[record]", "[run]: expected a record that needs a run"),
        (CRYSTAL, 'kind = "sound_speed"', 'kind = "sound_speed", band = 1', "one of kind, unit, relative_to, got"),
        (WORDS, 'unit = "mm"', 'unit = "mm", relative_to = {beads = 2}', "none beside relative_to"),
        (WORDS, "beads = [2, 3]", 'beads = [2, "3"]', "[vary] beads[1]: expected a number"),
        (WORDS, "[start]\nkind = \"random\"", "", "[vary]: expected one of"),
        (RANDOM, "{4 = 0.5}", '{four = 0.5}', "[scene] masses: expected a value, or numbers by the index"),
        (RANDOM, "to = 2}", "to = 1}", "[vary] stiffness: expected from below to"),
        (RANDOM, "to = 2}", "to = 2, count = 3}", "[vary] stiffness: expected one of from, to, scale, got 'count'"),
        (RANDOM, "seed = 3", "seed = -3", "[design] seed: expected a whole number"),
    ],
)
def test_other_files_are_refused_likewise(text, old, new, message):
    assert message in refused(changed(text, old, new))


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "[scene]: expected a table, got none"),
        (b"\xff\xfe\x00", "text in UTF-8, got other bytes in line 1"),
        (b"a = 1\nb = '\xe9'", "text in UTF-8, got other bytes in line 2"),
        (b"\xef\xbb\xbfscene = 1", "[scene]: expected a table of names and values, got 1"),
        (b"scene = " + b"[" * 5000 + b"]" * 5000, "12 deep at most"),
        (b"scene = " + b"[" * 100 + b"]" * 100, "12 deep at most"),
        (b".".join([b"a"] * 100_000) + b" = 1", "keys of a few parts"),
        (b"scene = '''" + b"x" * 2_000_000, "at most 1 MB"),
        (b"[scene]\nsites = " + b"9" * 10_000, "it is no TOML"),
        (b"[scene]\nsites = 0000-00-00", "it is no TOML"),
        (b"[scene]\nkind = 'dimer'\nkind = 'dimer'", "it is no TOML"),
        (MAP.encode()[: len(MAP) // 2 - 3], "it is no TOML"),
        (b"\0", "it is no TOML"),
    ],
    ids=range(13),
)
def test_files_of_other_content_are_a_sentence(content, message, tmp_path, capsys):
    (tmp_path / "odd.toml").write_bytes(content)
    began = time.process_time()
    assert main(["sweep", str(tmp_path / "odd.toml")]) == 2
    assert time.process_time() - began < 5
    said = [line for line in capsys.readouterr().err.splitlines() if "JAX has started" not in line]
    assert len(said) == 1 and message in said[0] and "odd.toml" in said[0]


def test_a_hundred_megabytes_are_not_read(tmp_path):
    with open(tmp_path / "large.toml", "wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(ValueError, match="large.toml: expected at most 1 MB"):
        recipe(tmp_path / "large.toml")
    for other in (tmp_path, tmp_path / "missing.toml", "a\0b"):
        with pytest.raises(ValueError, match="a TOML file that can be read"):
            recipe(other)


# what somebody may have put where a name or a value stands
MARK = "granjax_was_run"
ODD = [
    "nan", "inf", "-inf", "-0.0", "1e308", "-1e-320", "0", "-1", "3", "2.5", "9223372036854775808", "1" + "0" * 80,
    "''", "'free'", "'periodic'", "'steel 316'", "'RKN86'", "true", "[]", "{}", "[[]]", "[1, 'a']", "[0.5, nan]",
    "[1, 2]", "{from = 1, to = 2, count = 2}", "{from = 2, to = 1, count = 10000000000}", "{count = 3}",
    "{ratio = 1.0}", "{per_bead = 1e300, plus = 1}", "1979-05-27", "07:32:00", "'\\u0000'", '"\\u0000"', "'../x.nc'",
    "'/etc/passwd.nc'", "'.nc'", "'x.png'", f"'{{0.__class__}} %s $(touch {MARK})'",
    f"\"__import__('os').system('touch {MARK}')\"", f"'!!python/object/apply:os.system [\"touch {MARK}\"]'",
]
NAMES = [
    "kind", "sites", "ratio", "__class__", "__init__", "lattice", "field", "of", "bond", "from", "count", "scene",
    "start", "vary", "units", "record", "'radii[1]'", "'radii[-1]'", "'scene.ratio'", "start.velocity", "'a.b'", "''",
    "x", "é", "precompression", "self", "function", "lane",
]


def mutated(rng):
    """One of the valid files, damaged."""
    lines = list(ALL.values())[rng.integers(len(ALL))].strip().split("\n")
    for _ in range(rng.geometric(0.7)):
        i, kind = int(rng.integers(len(lines))), rng.integers(9)
        odd, name = ODD[rng.integers(len(ODD))], NAMES[rng.integers(len(NAMES))]
        key, equals, value = lines[i].partition(" = ")
        inner = re.findall(r"(\w+) = ([^,{}]+)", value)
        if kind == 0:
            del lines[i : i + 1 + int(rng.integers(3))]
        elif kind == 1:
            lines.insert(int(rng.integers(len(lines) + 1)), lines[i])
        elif kind == 2 and equals:
            lines[i] = f"{key} = {odd}"
        elif kind == 3 and equals:
            lines[i] = f"{name} = {value}"
        elif kind == 4 and inner:
            old, given = inner[rng.integers(len(inner))]
            lines[i] = lines[i].replace(f"{old} = {given}", f"{old} = {odd}")
        elif kind == 5 and inner:
            lines[i] = lines[i].replace(f"{inner[rng.integers(len(inner))][0]} =", f"{name} =")
        elif kind == 6:
            lines.insert(i, f"{name} = {odd}")
        elif kind == 7:
            other = list(ALL.values())[rng.integers(len(ALL))].strip().split("\n")
            lines[i] = other[rng.integers(len(other))]
        else:
            at = int(rng.integers(len(lines[i]) + 1))
            lines[i] = lines[i][:at] + chr(int(rng.integers(1, 0x250))) + lines[i][at + int(rng.integers(2)) :]
        if not lines:
            break
    content = "\n".join(lines).encode()
    if rng.random() < 0.05:
        content = content[: int(rng.integers(len(content) + 1))]
    if rng.random() < 0.05:
        content = bytes(rng.integers(0, 256, 40, np.uint8)) + content
    return content


# what may be meant somewhere in a file
WORDS_KNOWN = [*SCENES, *STARTS, *QUANTITIES, *RUN, *REST, *SOLVERS, "fixed", "free", "periodic", "steel 316", "rigid",
               "uniform", "left", "right", "log", "grid", "paired", "random", "SI", "scaled", "N", "m/s", "kHz", "us"]
KEYS = [*dict.fromkeys(re.findall(r"(\w+) = ", "".join(ALL.values()))), "tolerance", "amplitude", "exponent", "centre",
        "k", "speed", "temperature", "alpha", "ratios", "wall", "cells", "damping_time", "left", "c", "q", "mode"]


def value(rng, depth=0):
    """A random value that TOML can hold."""
    kind = rng.integers(9 if depth < 2 else 5)
    if kind == 0:
        return WORDS_KNOWN[rng.integers(len(WORDS_KNOWN))]
    if kind == 1:
        return float(rng.choice([0.0, 0.3, 0.5, 1.0, 2.5, -1.0, 1e-3, 1e200, 5e-324, np.inf, np.nan]))
    if kind in (2, 3):
        return int(rng.choice([0, 1, 2, 3, 7, -1, -2, 30, 2**40]))
    if kind == 4:
        return bool(rng.integers(2))
    if kind < 7:
        return [value(rng, depth + 1) for _ in range(rng.integers(4))]
    return {KEYS[rng.integers(len(KEYS))]: value(rng, depth + 1) for _ in range(rng.integers(3))}


def rearranged(rng):
    """The tables of one of the valid files, with some values, keys or tables of others."""
    tree, other = (parsed(list(ALL.values())[rng.integers(len(ALL))].encode()) for _ in range(2))
    for _ in range(rng.geometric(0.6)):
        table = tree
        while (inner := [x for x in table.values() if isinstance(x, dict) and x]) and rng.random() < 0.8:
            table = inner[rng.integers(len(inner))]
        keys, kind = list(table), rng.integers(5)
        if kind == 0:
            table[KEYS[rng.integers(len(KEYS))]] = value(rng)
        elif kind == 1 and keys:
            table[keys[rng.integers(len(keys))]] = value(rng)
        elif kind == 2 and keys:
            del table[keys[rng.integers(len(keys))]]
        elif kind == 3:
            name = list(other)[rng.integers(len(other))]
            tree[name] = other[name]
        elif keys:
            key = keys[rng.integers(len(keys))]
            if isinstance(table[key], str):
                table[key] = WORDS_KNOWN[rng.integers(len(WORDS_KNOWN))]
            elif isinstance(table[key], (int, float)):
                table[key] = type(table[key])(rng.choice([1, 2, 3, 5, -1, 0, 50]))
    return tree


def tried(seed, count):
    """How many of some damaged files are files of sweeps all the same."""
    rng, good = np.random.default_rng(seed), 0
    for _ in range(count):
        content = mutated(rng) if rng.random() < 0.4 else rearranged(rng)
        try:
            made = recipe_of(parsed(content) if isinstance(content, bytes) else content)
            made.check()
        except ValueError as error:
            said = str(error)
            assert said and "\n" not in said and "Traceback" not in said, content
        except BaseException as error:
            raise AssertionError(content) from error
        else:
            good += 1
            assert str(made)
    return good


@pytest.mark.slow
def test_damaged_files_are_a_sweep_or_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert 10 < tried(1, 200) < 150
    assert not os.listdir(tmp_path)


@pytest.mark.study
def test_ten_thousand_damaged_files_are_a_sweep_or_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert tried(2, 10_000) > 500
    assert not os.listdir(tmp_path)


TINY = """
[scene]
kind = "dimer"
sites = 6
[start]
kind = "impact"
[vary]
ratio = {from = 0.5, to = 1.0, count = 3}
[run]
until = {per_bead = 1.5, plus = 4}
[record]
force = {kind = "peak", of = "contact_force", bond = -1}
through = {kind = "peak", of = "contact_force", bond = -1, relative_to = {ratio = 1.0}}
[result]
picture = "tiny.png"
show = "through"
table = "tiny.csv"
"""


def complaints(capsys):
    return [line for line in capsys.readouterr().err.splitlines() if "JAX has started" not in line]


@pytest.mark.study
def test_a_sweep_from_beginning_to_end(tmp_path, capsys):
    (tmp_path / "tiny.toml").write_text(TINY)
    assert main(["sweep", str(tmp_path / "tiny.toml"), "--out", str(tmp_path / "made")]) == 0
    printed = capsys.readouterr()
    assert "ratio" in printed.out and "Written: " in printed.out
    assert sorted(os.listdir(tmp_path / "made")) == ["tiny.csv", "tiny.png"]
    assert matplotlib.image.imread(tmp_path / "made" / "tiny.png").shape[2] in (3, 4)
    data = datasets.load(tmp_path / "made" / "tiny.csv")
    chain = gx.scenes.dimer(6, ratio=0.5)
    run = gx.simulate(chain, gx.states.impact(chain), 13.0, tolerance=1e-10,
                      record={"force": gx.Peak(gx.measures.contact_force)})
    np.testing.assert_allclose(data["force"][0], run.recorded["force"][-1], rtol=1e-5)
    np.testing.assert_allclose(data["through"], data["force"] / data["force"][-1], rtol=1e-5)
    np.testing.assert_array_equal(data["ratio"], [0.5, 0.75, 1.0])


def test_check_says_what_would_be_computed(tmp_path, capsys):
    (tmp_path / "map.toml").write_text(MAP)
    assert main(["sweep", "--check", str(tmp_path / "map.toml"), "--out", str(tmp_path / "made")]) == 0
    out = capsys.readouterr().out
    assert "6 lanes of 'dimer'" in out and "relative to ratio = 1.0" in out
    assert os.listdir(tmp_path) == ["map.toml"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--workers", "0"], "--workers: expected a whole number not below 1, got 0."),
        (["--workers", "100000"], "--workers: expected at most 512"),
        (["--workers", "2", "--dask", "tcp://x:1"], "--workers: expected workers of one's own, or --dask, got both"),
        (["--resume"], "--resume: expected a store in the file, got none"),
        (["--resum"], "--resume: expected a store in the file, got none"),
        (["--out", "FILE/folder"], "--out: expected a folder that can be made and written"),
        (["--devices", "2"], "unrecognized arguments"),
    ],
)
def test_bad_arguments_are_one_sentence(arguments, message, tmp_path, capsys):
    (tmp_path / "tiny.toml").write_text(TINY)
    (tmp_path / "FILE").write_text("not a folder")
    arguments = [a.replace("FILE", str(tmp_path / "FILE")) for a in arguments]
    assert main(["sweep", str(tmp_path / "tiny.toml"), *arguments]) == 2
    said = complaints(capsys)
    assert len(said) == 1 and message in said[0]


def test_what_an_interrupted_run_has_begun_is_not_overwritten(tmp_path, capsys, monkeypatch):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "map.nc.chunks").mkdir()
    asked = []

    def interrupted(*arguments, **options):
        asked.append(options)
        raise KeyboardInterrupt

    monkeypatch.setattr(gx, "sweep", interrupted)
    command = ["sweep", str(tmp_path / "map.toml"), "--out", str(tmp_path)]
    assert main(command) == 2
    said = complaints(capsys)
    assert len(said) == 1 and "--resume goes on with it" in said[0] and not asked
    assert main([*command, "--resume", "--workers", "2"]) == 130
    said = complaints(capsys)
    assert len(said) == 1 and "finished chunks are kept in" in said[0] and "--resume" in said[0]
    assert [(o["executor"], o["chunk"], o["store"]) for o in asked] == [(2, 8, tmp_path / "map.nc")]


@pytest.mark.slow
def test_a_store_of_another_file_is_refused_with_the_difference(tmp_path, capsys):
    (tmp_path / "tiny.toml").write_text(changed(TINY, "[result]", '[result]\nstore = "tiny.nc"'))
    command = ["sweep", str(tmp_path / "tiny.toml"), "--out", str(tmp_path)]
    assert main(command) == 0
    data = datasets.load(tmp_path / "tiny.nc")
    assert main(command) == 0 and datasets.load(tmp_path / "tiny.nc").identical(data)
    capsys.readouterr()
    for old, new, said in (("plus = 4", "plus = 5", "[run] until"), ("bond = -1}", "bond = -2}", "[record.force]")):
        (tmp_path / "tiny.toml").write_text(changed(TINY, "[result]", '[result]\nstore = "tiny.nc"').replace(old, new))
        assert main(command) == 2
        told = complaints(capsys)
        assert len(told) == 1 and said in told[0], told


@pytest.mark.study
def test_lanes_that_fail_are_told_and_code_1(tmp_path, capsys):
    text = TINY.partition("through =")[0]
    text += 'when = {kind = "arrival", of = "velocity", site = -1, threshold = 0.9}\n'
    (tmp_path / "tiny.toml").write_text(text)
    assert main(["sweep", str(tmp_path / "tiny.toml"), "--out", str(tmp_path)]) == 1
    assert "of 3 lanes are marked" in "".join(complaints(capsys))
