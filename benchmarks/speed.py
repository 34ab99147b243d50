"""How fast is granjax beside numba loops written by hand? `python benchmarks/speed.py [--quick]`

Writes speed.json (every figure, with its target and whether it is met) and speed.png beside this file; `--quick` is a
smoke test that every case runs and agrees: it leaves out the processes without flags, judges no target, and writes
nothing unless `--out` names a folder. Needs `pip install granjax[bench]`.

Every figure is measured twice, in processes of their own that take turns: with the XLA flags that `import granjax`
sets, and without (`GRANJAX_TUNE=0`). All run on one core except where two are the question. Elapsed times decide; the
processor times beside them tell the same where other processes disturb.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
FLAGS = {"tuned": "1", "plain": "0"}
PACKAGES = ("granjax", "jax", "jaxlib", "diffrax", "equinox", "numpy", "numba", "scipy")
AGREEMENT = 1e-9

# name: (function, arguments, arguments of --quick, target)
CASES = {
    "N = 100": (
        "chain",
        dict(sites=100, steps=50000),
        dict(sites=100, steps=500),
        ("at most", 1.5),
    ),
    "N = 96 ... 128": (
        "lengths",
        dict(lengths=(96, 100, 104, 128), steps=50000),
        dict(lengths=(9, 12), steps=500),
        ("at most", 1.4),
    ),
    "N = 1000": (
        "chain",
        dict(sites=1000, steps=6000),
        dict(sites=1000, steps=50),
        ("at most", 1.25),
    ),
    "N = 100 000": (
        "chain",
        dict(sites=100_000, steps=100),
        dict(sites=10_000, steps=5),
        ("at most", 1.2),
    ),
    "N = 1 000 000": (
        "chain",
        dict(sites=1_000_000, steps=24),
        dict(sites=10_000, steps=5),
        ("at most", 1.1),
    ),
    **{
        f"shock, N = {n:,}".replace(",000", " 000"): (
            "shock",
            dict(sites=n, steps=steps),
            dict(sites=n // 50, steps=5),
            ("at most", 1.3 if n == 100_000 else 1.4),
        )
        for n, steps in (
            (1000, 6000),
            (10_000, 600),
            (30_000, 200),
            (100_000, 200),
            (300_000, 80),
            (1_000_000, 24),
        )
    },
    "square, 300 x 300": (
        "packing",
        dict(name="square", cells=(300, 300), steps=200),
        dict(name="square", cells=(20, 20), steps=5),
        ("at most", 2.0),
    ),
    "triangular, 1e5": (
        "packing",
        dict(name="triangular", cells=(317, 317), steps=60, d0=1.0),
        dict(name="triangular", cells=(20, 20), steps=5, d0=1.0),
        ("at most", 3.0),
    ),
    "256 dimers of 60": ("batch", dict(steps=400), dict(steps=4), ("at most", 0.9)),
    "256 dimers, adaptive": (
        "lanes_apart",
        dict(lanes=256, beads=60, end=20.0),
        dict(lanes=8, beads=8, end=2.0),
        ("at most", 1.2),
    ),
    "1024 of 20, adaptive": (
        "lanes_apart",
        dict(lanes=1024, beads=20, end=20.0),
        dict(lanes=8, beads=8, end=2.0),
        ("at most", 1.0),
    ),
    "two cores": ("two_devices", dict(steps=800), dict(steps=8), ("at least", 1.8)),
    "float32, N = 1000": ("single", dict(sites=1000, steps=6000), dict(sites=1000, steps=50), None),
    "float32 / float64": (
        "precisions",
        dict(sites=1000, steps=6000),
        dict(sites=1000, steps=50),
        ("at most", 0.6),
    ),
    "p = 1.4, N = 1000": (
        "chain",
        dict(sites=1000, steps=600, exponent=1.4),
        dict(sites=100, steps=20, exponent=1.4),
        ("at most", 0.5),
    ),
    "p traced, N = 1000": (
        "chain",
        dict(sites=1000, steps=600, exponent=1.4, traced=True),
        dict(sites=100, steps=20, exponent=1.4, traced=True),
        ("at most", 0.5),
    ),
    "call, step": (
        "overhead",
        dict(options=dict(step=0.1)),
        dict(options=dict(step=0.1), calls=2),
        ("at most", 150),
    ),
    "call, default": ("overhead", dict(options={}), dict(options={}, calls=2), None),
    "call, tolerance": (
        "overhead",
        dict(options=dict(tolerance=1e-3)),
        dict(options=dict(tolerance=1e-3), calls=2),
        None,
    ),
    "impact, adaptive": ("impact", dict(), dict(quick=True), None),
}
CALL = "microseconds a call on 4 beads costs beyond its steps"
UNITS = {
    **dict.fromkeys(
        ("256 dimers, adaptive", "1024 of 20, adaptive"), "time over that of a loop of single calls"
    ),
    "two cores": "time on one core over time on two",
    "float32 / float64": "time in float32 over that in float64",
    "call, step": CALL,
    "call, default": CALL,
    "call, tolerance": CALL,
    "impact, adaptive": "time over that of the numba loop at equal error",
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="tiny sizes, one round; numbers mean nothing"
    )
    parser.add_argument(
        "--only", nargs="*", choices=list(CASES), help="these cases alone, printed and not written"
    )
    parser.add_argument("--out", type=Path, help="folder for speed.json and speed.png")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--verbose", action="store_true", help="tracebacks of cases that fail")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(measure(options.child, options.rounds, options.quick)))
        return
    result = {
        **circumstances(),
        "quick": options.quick,
        "rounds": 1 if options.quick else options.rounds,
    }
    result["figures"] = [figure(name, options) for name in options.only or CASES]
    busy = [f["tuned"]["busy"] for f in result["figures"] if "busy" in f["tuned"]]
    result["quiet"] = bool(busy) and max(busy) < 1.1
    if not result["quiet"] and not options.quick:
        print(
            "The machine was busy: elapsed time exceeded processor time by more than a tenth. Run again when quiet."
        )
    folder = options.out or (None if options.quick or options.only else HERE)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "speed.json").write_text(json.dumps(result, indent=1) + "\n")
        chart(result, folder / "speed.png")
    if not all(f["agrees"] for f in result["figures"]):
        sys.exit("Some case failed, or its final state differs from the numba loop's.")


def measure(name, rounds, quick):
    """In the child: one case, on one core where that is meant."""
    function, full, small, _ = CASES[name]
    if function == "two_devices":
        import jax

        jax.config.update("jax_num_cpu_devices", 2)
    elif hasattr(os, "sched_setaffinity"):
        # before JAX starts, so that its pools have one thread
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    import adaptive
    import cases

    call = getattr(cases, function, None) or getattr(adaptive, function)
    return call(1 if quick else rounds, **(small if quick else full))


def figure(name, options):
    """One case with and without the flags; a case that fails is marked, and the others stand."""
    measured = {}
    # without the flags one device already uses many threads, so that there is no one core to compare with
    for flags in ("tuned",) if options.quick or name == "two cores" else FLAGS:
        environment = {
            **os.environ,
            "GRANJAX_TUNE": FLAGS[flags],
            "PYTHONPATH": f"{HERE.parent}{os.pathsep}{HERE}",
        }
        environment.pop("XLA_FLAGS", None)
        command = [
            sys.executable,
            str(HERE / "speed.py"),
            "--child",
            name,
            "--rounds",
            str(options.rounds),
        ]
        command += ["--quick"] if options.quick else []
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode and options.verbose:
            print(done.stderr, file=sys.stderr)
        measured[flags] = (
            _failure(done.stderr) if done.returncode else json.loads(done.stdout.splitlines()[-1])
        )
    return _judged(name, measured, options.quick)


def _failure(text):
    """The line that names the error; JAX writes more after it."""
    lines = [line for line in text.splitlines() if line.split(":")[0].endswith("Error")]
    return {"ratio": None, "error": lines[-1] if lines else text.strip()[-200:] or "no output"}


def _judged(name, measured, quick):
    tuned = measured["tuned"]
    plain = measured.get("plain", {"ratio": None})
    target = None if quick else CASES[name][3]
    value = tuned["ratio"]
    unit = UNITS.get(name, "time over that of the numba loop")
    met = None
    if target is not None:
        met = value is not None and (
            value <= target[1] if target[0] == "at most" else value >= target[1]
        )
    limit = 1e-3 if name.startswith("float32") else AGREEMENT
    agrees = "error" not in tuned and "error" not in plain and tuned.get("difference", 0.0) <= limit
    row = {
        "name": name,
        "unit": unit,
        "value": value,
        "value_without_flags": plain["ratio"],
        "target": None if target is None else f"{target[0]} {target[1]}",
        "met": met,
        "agrees": agrees,
        **measured,
    }
    print(_line(row), flush=True)
    return row


def _line(row):
    """One row for the terminal."""

    def number(x):
        return "      -" if x is None else f"{x:7.2f}"

    cpu = number(row["tuned"].get("cpu_ratio"))
    goal = (
        "" if row["target"] is None else f"  {row['target']}: {'met' if row['met'] else 'MISSED'}"
    )
    problem = (
        ""
        if row["agrees"]
        else f"  PROBLEM: {row['tuned'].get('error', row['tuned'].get('difference'))}"
    )
    value = number(row["value"])
    plain = number(row["value_without_flags"])
    return f"{row['name']:<20}{value} (processor time {cpu}; no flags {plain}) {row['unit']}{goal}{problem}"


def circumstances():
    """Machine, versions, commit."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.is_file() else ""
    names = [
        line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")
    ]

    def git(*arguments):
        done = subprocess.run(
            ["git", "-C", str(HERE), *arguments], capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    return {
        "date": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()),
        "machine": {
            "processor": names[0] if names else platform.processor(),
            "cores": os.cpu_count(),
            "avx512": "avx512f" in text,
            "system": platform.platform(),
            "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        },
        "versions": {
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
        "commit": git("rev-parse", "HEAD"),
        "modified": bool(git("status", "--porcelain", "--", "../granjax")),
    }


def _version(name):
    from importlib.metadata import PackageNotFoundError

    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def chart(result, path):
    """Bars of the ratios, with and without the flags; targets as lines."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = [f for f in result["figures"] if f["value"] is not None and f["unit"] != CALL]
    figure, axes = plt.subplots(figsize=(7.5, 1 + 0.42 * len(shown)), layout="constrained")
    for i, f in enumerate(shown):
        for shift, key, colour in (
            (-0.2, "value", "tab:blue"),
            (0.2, "value_without_flags", "tab:gray"),
        ):
            if f[key] is None:
                continue
            axes.barh(i + shift, f[key], 0.38, color=colour)
            axes.text(f[key], i + shift, f" {f[key]:.2f}", va="center", fontsize=8)
        if f["target"] is not None:
            limit = float(f["target"].split()[-1])
            axes.plot([limit, limit], [i - 0.45, i + 0.45], color="tab:red", lw=2)
    axes.axvline(1, color="black", lw=0.6, ls=":")
    names = [f["name"] + (" (speed-up)" if f["name"] == "two cores" else "") for f in shown]
    axes.set_yticks(range(len(shown)), names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("time over the numba loop's")
    axes.barh(0, 0, color="tab:blue", label="with granjax's XLA flags")
    axes.barh(0, 0, color="tab:gray", label="without")
    axes.plot([], [], color="tab:red", label="target")
    axes.legend(fontsize=8)
    machine = result["machine"]["processor"] + (
        "" if result["quiet"] else ", busy: numbers are not final"
    )
    axes.set_title(f"SRKN11b through gx.simulate, one core ({machine})", fontsize=9)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()
