"""Does everything that is said about speed and accuracy stand in a JSON? `python benchmarks/claims.py [--check]`

Reads the JSONs beside this file, works out what the README and the docstrings say from them, and writes claims.json:
file, sentence, figures, where they come from, whether the sentence stands in its file. `--check` writes nothing and
exits with 1 where a sentence is missing or claims.json is not what the JSONs give.
"""

import argparse
import json
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent


def data(name):
    """A benchmark's JSON."""
    return json.loads((HERE / f"{name}.json").read_text())


def speed(case, key="value"):
    """A figure of speed.json."""
    return next(row for row in data("speed")["figures"] if row["name"] == case)[key]


def seconds(scene, error, method):
    """Time of a method, or of the best of a family, at an error on a scene of precision.json."""
    row = data("precision")["scenes"][scene]["figures"][error]
    return (
        row["families"][method]["seconds"] if method in row["families"] else row["seconds"][method]
    )


def over(scene, error, peer):
    """How many times the time of granjax's best the peer needs."""
    return seconds(scene, error, peer) / seconds(scene, error, "granjax")


def orders(scene, methods):
    """Observed orders of granjax's methods at fixed steps."""
    found = {m["name"]: m["order"] for m in data("precision")["scenes"][scene]["methods"]}
    return [found[f"granjax {name}"] for name in methods]


SPLITTING = ("SRKN6b", "SRKN11b", "SRKN14a", "KahanLi8", "SofroniouSpaletta10")


def claims():
    """(file, sentence, figures, source) of everything that is said."""
    loops = [over("impact", e, "numba, splitting") for e in ("1e-06", "1e-07")]
    peers = [over("impact", "1e-06", x) for x in ("scipy DOP853", "numbalsoda")]
    smooth = [
        over("smooth", e, x) for e in ("1e-06", "1e-10") for x in ("numba, splitting", "heyoka")
    ]
    yield (
        "README.md",
        f"On the impact granjax (RKN 8(6)) is {loops[0]:.1f} times faster than the best numba loop of a splitting "
        f"method at 1e-6 and {loops[1]:.1f} times at 1e-7; at 1e-6 it is {peers[0]:.0f} times faster than SciPy's "
        f"DOP853 and {peers[1]:.1f} times faster than numbalsoda.",
        {"numba": loops, "others": peers},
        "precision.json: scenes.impact.figures",
    )
    yield (
        "README.md",
        f"On the smooth chain (RKN 12(10)) it is {smooth[0]:.1f} times faster than the best such loop at 1e-6 and "
        f"{smooth[2]:.1f} times at 1e-10, and {smooth[1]:.0f} and {smooth[3]:.0f} times faster than heyoka.",
        {"figures": smooth},
        "precision.json: scenes.smooth.figures",
    )
    maps = data("monodromy")["monodromy"]
    family = data("monodromy")["family"]
    row = maps["figures"]["1e-09"]
    whole = min(
        t for name, t in row["seconds"].items() if name.startswith("granjax") and "half" not in name
    )
    ratios = [row["ratio"] for row in maps["like_with_like"].values()]
    others = [row["families"][x]["seconds"] / whole for x in ("heyoka", "scipy")]
    yield (
        "README.md",
        f"The matrix to 1e-9 takes {min(ratios):.1f} to {max(ratios):.1f} times as long as in a numba loop of the same "
        f"method with tangents; heyoka takes {others[0]:.0f} times as long as granjax, and SciPy's DOP853 "
        f"{others[1]:.0f} times.",
        {"numba": ratios, "others": others},
        "monodromy.json: monodromy",
    )
    yield (
        "README.md",
        f"A family of {family['points']} breathers with all multipliers takes {family['fresh']['median']:.1f} s from a "
        f"cold shell, import and compiling included.",
        {"seconds": family["fresh"]["median"]},
        "monodromy.json: family",
    )
    numba = [
        over(scene, e, "numba, Nyström")
        for scene in ("impact", "smooth")
        for e in ("1e-06", "1e-08", "1e-10")
    ]
    yield (
        "README.md",
        f"Numba loops of the same Nyström pairs, written for this chain alone, need {min(numba):.2f} to "
        f"{max(numba):.2f} times granjax's time at 1e-6 to 1e-10.",
        {"figures": numba},
        "precision.json: scenes.*.figures",
    )
    ratios = [speed(x) for x in ("N = 100", "N = 1000", "N = 100 000", "256 dimers of 60")]
    yield (
        "README.md",
        f"The ratio is {ratios[0]:.2f}, {ratios[1]:.2f} and {ratios[2]:.2f} for 100, 1000 and 1e5 beads and "
        f"{ratios[3]:.2f} for a batch; a second core makes the batch {speed('two cores'):.2f} times as fast; float32 "
        f"takes {speed('float32 / float64'):.2f} of the time of float64; a general exponent takes "
        f"{speed('p = 1.4, N = 1000'):.2f} of the time of a loop with `x**p`.",
        {"ratios": ratios},
        "speed.json: figures",
    )
    calls = [speed(x) for x in ("call, step", "call, tolerance", "call, default")]
    yield (
        "README.md",
        f"A call costs {calls[0]:.0f} microseconds beyond its steps (with a tolerance {calls[1]:.0f}, with the default "
        f"step {calls[2]:.0f}).",
        {"microseconds": calls},
        "speed.json: figures",
    )
    found = orders("impact", SPLITTING)
    yield (
        "README.md",
        "Where a contact opens, the force is only once differentiable: no method at a fixed step then has an order "
        "above about 5/2, whatever its name.",
        {"orders": found, "mean": sum(found) / len(found)},
        "precision.json: scenes.impact.methods",
    )
    tasks = {row["name"]: row["ratio"] for row in data("flags")["tasks"]}
    worst = max(tasks, key=tasks.get)
    others = max(ratio for name, ratio in tasks.items() if name != worst)
    yield (
        "README.md",
        f"Of nine other tasks in the process (`benchmarks/flags.py`) eight take {min(tasks.values()):.2f} to "
        f"{others:.2f} of the time they take without them; a loop over an array of 1e6 numbers, which then has one "
        f"thread, takes {tasks[worst]:.1f}.",
        {"ratios": tasks, "slowest": worst},
        "flags.json: tasks",
    )
    undone = [
        r
        for r in data("gradient")["rows"]
        if r["scene"] == "precompressed" and r["adjoint"] == "Reversible"
    ]
    longest = max(undone, key=lambda r: r["steps"])["steps"]
    slowest = max(r["ratio"] for r in undone)
    kept = {r["bytes"] for r in undone if r["parameters"] == "one stiffness"}
    yield (
        "README.md",
        f"a gradient of 100 to {longest} steps of 100 beads takes {min(r['ratio'] for r in undone):.1f} to "
        f"{slowest:.1f} times the run and {max(kept) / 1000:.0f} kB, however many the steps",
        {"ratio": [r["ratio"] for r in undone], "bytes": sorted(kept)},
        "gradient.json: rows",
    )
    fitting = data("gradient")["fit"]["seconds"]
    yield (
        "README.md",
        f"a fit of four parameters to 1600 samples {fitting:.1f} s once compiled",
        {"seconds": fitting},
        "gradient.json: fit",
    )
    yield (
        "granjax/solvers/nystrom.py",
        "contacts that open and errors below 1e-5",
        {"RKN86 over the best splitting method at 1e-5": _own("impact", "1e-05", "RKN86")},
        "precision.json: scenes.impact.figures",
    )
    yield (
        "granjax/solvers/nystrom.py",
        "for smooth scenes and errors below 1e-8",
        {"RKN1210 over the best other at 1e-8": _own("smooth", "1e-08", "RKN1210")},
        "precision.json: scenes.smooth.figures",
    )


def _own(scene, error, name):
    """Time of one of granjax's methods over that of its best other one."""
    times = data("precision")["scenes"][scene]["figures"][error]["seconds"]
    own = times[f"granjax {name}"]
    return own / min(t for n, t in times.items() if n.startswith("granjax") and name not in n)


def flat(text):
    """Words alone: line ends and indentation do not count."""
    return " ".join(text.split())


def rows():
    """The lines of claims.json."""
    return [
        {
            "file": file,
            "sentence": sentence,
            "figures": figures,
            "source": source,
            "stands": flat(sentence) in flat((ROOT / file).read_text()),
        }
        for file, sentence, figures, source in claims()
    ]


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit code 1 where something is not so"
    )
    options = parser.parse_args()
    found = rows()
    for row in found:
        print("stands " if row["stands"] else "MISSING", row["file"], "|", row["sentence"])
    if not options.check:
        (HERE / "claims.json").write_text(json.dumps(found, indent=1) + "\n")
    elif found != json.loads((HERE / "claims.json").read_text()):
        sys.exit("claims.json is not what the JSONs give.")
    if not all(row["stands"] for row in found):
        sys.exit("A sentence is not where it should be.")


if __name__ == "__main__":
    main()
