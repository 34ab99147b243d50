"""The command line: `granjax resonance`, `granjax reproduce`, `granjax bench`.

Results go to standard output, everything else to standard error, or to standard output where that is closed. Exit
codes: 0; 1 where a computation failed, a figure disagrees or a result could not be written to its place; 2 for input
that cannot be meant, with a sentence; 130 where it was interrupted; 141 where nobody reads standard output any more.
"""

import argparse
import json
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import granjax as gx

from ..checks import refuse, whole
from ..files import folder, netcdf, target
from ..interrupts import INTERRUPTED, prepare_command
from ..tuning import keep_compiled
from .bench import bench
from .output import UNREAD, complain, keep, say

LEAST_RATIOS = 3
LOWEST_RATIO = 0.05
DEFINITION = (
    "largest force on a rigid wall behind a struck 1:1 dimer chain (heavy bead first, Hertz contacts, no "
    "precompression) over that of the monomer chain"
)


def command() -> NoReturn:
    """The process `granjax`: `main`, and its end."""
    prepare_command()
    try:
        code = main()
    except SystemExit as end:  # of --help and --version
        code = end.code or say("")
    # threads of XLA may be at work still, and what could not be written would be tried again
    os._exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; `argv` without the program's name, `None` for that of the process. Returns the exit code."""
    try:
        arguments = _parser().parse_args(argv)
        if arguments.command is None:
            return say(_parser().format_help().rstrip())
        _prepare(not arguments.no_cache)
        return arguments.command(arguments)
    except (ValueError, OSError) as error:
        return complain(error, 2)
    except RuntimeError as error:
        return complain(error, 1)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise ValueError(f"{message}. See {self.prog} --help.")


def _parser():
    parser = _Parser(prog="granjax", description="Differentiable simulator of nonlinear lattices on JAX.")
    parser.add_argument("--version", action="version", version=f"granjax {gx.__version__}")
    parser.add_argument(
        "--no-cache", action="store_true",
        help="compile anew; otherwise programs are kept in your cache folder (or in the folder GRANJAX_CACHE)",
    )
    parser.set_defaults(command=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")

    text = "Transmission of a struck dimer chain to a wall over the mass ratio: picture, data, resonances."
    resonance = commands.add_parser("resonance", help=text, description=text)
    resonance.add_argument("--beads", type=int, default=101, help="beads of the chain, 3 or more (default: 101)")
    resonance.add_argument(
        "--ratios", type=int, default=200, metavar="N",
        help=f"mass ratios in ({LOWEST_RATIO:g}, 1], {LEAST_RATIOS} or more (default: 200)",
    )
    resonance.add_argument(
        "--out", default=".", metavar="PLACE",
        help="folder for resonance.png and resonance.nc, or a path ending in .png or .nc for other names",
    )
    resonance.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    resonance.set_defaults(command=_resonance)

    text = "Figures of Chong and Kevrekidis, Dynamics of Nonlinear Lattices: picture, data, one number to check."
    reproduce = commands.add_parser("reproduce", help=text, description=text)
    reproduce.add_argument("figures", nargs="*", metavar="FIGURE", help="labels such as fig2.2")
    reproduce.add_argument("--list", action="store_true", help="list the figures and stop")
    reproduce.add_argument("--all", action="store_true", help="all figures")
    reproduce.add_argument("--check", action="store_true", help="compare the numbers; exit code 1 where one disagrees")
    reproduce.add_argument(
        "--out", metavar="DIR", help="folder for pictures and data (default: current folder; none with --check)"
    )
    reproduce.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="another value of a chosen parameter"
    )
    reproduce.set_defaults(command=_reproduce)

    text = "Error against time of many solvers on the canonical scenes: charts, data, advice."
    scenes = commands.add_parser("bench", help=text, description=text)
    scenes.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="names of scenes (default: the quick ones, two minutes)",
    )
    scenes.add_argument("--all", action="store_true", help="all scenes, the quick ones first")
    scenes.add_argument("--list", action="store_true", help="list the scenes with the time they take, and stop")
    scenes.add_argument("--out", default=".", metavar="DIR", help="folder for bench-SCENE.png and bench-SCENE.json")
    scenes.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    scenes.add_argument("--repeats", type=int, default=5, metavar="N", help="timed calls of each point (default: 5)")
    scenes.set_defaults(command=bench)
    return parser


def _prepare(cache):
    """XLA's flags, one device per core, and the cache of compiled programs, before JAX's first computation."""
    import jax

    # what is not kept, or was not kept whole, is compiled again
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    if cache:
        keep_compiled()
    tuning = gx.tune()
    if not tuning.complete and os.environ.get("GRANJAX_TUNE", "1") != "0":
        complain(tuning.outcome)
    chosen = "xla_force_host_platform_device_count" in tuning.flags or jax.config.jax_num_cpu_devices > 0
    if not chosen:
        try:
            jax.config.update("jax_num_cpu_devices", _cores())
        except RuntimeError:
            complain("JAX has started already, so the cores stay as they are shared.")


def _cores():
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _resonance(arguments):
    import numpy as np

    count = whole("--ratios", arguments.ratios, LEAST_RATIOS, "An extremum lies between two others.")
    beads = whole("--beads", arguments.beads, 3, "A dimer chain between walls.")
    picture, data = _places(arguments.out)
    ratios = np.linspace(LOWEST_RATIO, 1, count + 1)[1:]
    watched = sys.stderr is not None
    sweep = gx.resonance.transmission(ratios, beads, progress=watched)
    extrema = gx.resonance.refine(sweep, progress=watched)
    if arguments.json:
        columns = {
            "mass_ratio": sweep.mass_ratio, "transmission": sweep.transmission,
            "resonances": extrema.resonances, "anti_resonances": extrema.anti_resonances,
        }
        code = say(json.dumps({name: column.tolist() for name, column in columns.items()}))
    else:
        code = say("\n".join(_table(sweep, extrema)))
    kept = [keep(data, _data(sweep, extrema)), keep(picture, _picture(sweep, extrema, picture.suffix))]
    if not any(kept) and not arguments.json:
        code = code or say(f"Written: {picture}, {data}")
    return code or max(kept)


def _places(out):
    """Paths of picture and data; their folder is made where it is missing."""
    stem = Path(out).with_suffix("") if Path(out).suffix in (".png", ".nc") else Path(out) / "resonance"
    folder("--out", stem.parent)
    return target("--out", f"{stem}.png"), target("--out", f"{stem}.nc")


def _picture(sweep, extrema, ending):
    # the extrema among the points, so that cusps are sharp
    ratios = [*sweep.mass_ratio, *extrema.resonances, *extrema.anti_resonances]
    values = [*sweep.transmission, *extrema.resonance_transmission, *extrema.anti_resonance_transmission]
    with gx.plots.style():
        canvas = gx.plots.figure(6.4, 4.0)
        gx.plots.transmission(
            ratios, values, canvas.subplots(), resonances=extrema.resonances, anti_resonances=extrema.anti_resonances
        )
        return gx.plots.drawn(canvas, ending)


def _data(sweep, extrema):
    data = sweep.to_xarray().merge(extrema.to_xarray(), combine_attrs="drop_conflicts")
    data.attrs |= {
        "definition": DEFINITION, "granjax_version": gx.__version__,
        "units": "mass of the heavy bead m = 1, contact stiffness A = 1, striker's velocity v = 1",
    }
    return netcdf(data)


def _table(sweep, extrema):
    yield f"Dimer chain of {sweep.beads} beads and a wall, {len(sweep.mass_ratio)} mass ratios."
    yield "mass ratio  transmission"
    rows = [(x, T, "resonance") for x, T in zip(extrema.resonances, extrema.resonance_transmission)]
    rows += [(x, T, "anti-resonance") for x, T in zip(extrema.anti_resonances, extrema.anti_resonance_transmission)]
    for x, T, kind in sorted(rows):
        yield f"{x:10.4f}  {T:12.4f}  {kind}"
    known = ", ".join(f"{x:g}" for x in gx.resonance.ANTI_RESONANCES)
    yield f"Literature: first resonance {gx.resonance.FIRST_RESONANCE:g}; anti-resonances {known}."
    yield (
        "Those anti-resonances are zeros of the asymptotic decay rate, which the maxima of a chain of "
        f"{sweep.beads} beads have not reached yet; gx.resonance.anti_resonance(low, high) finds them."
    )


def _reproduce(arguments):
    if arguments.list:
        return say(gx.reproduce.listing())
    if bool(arguments.figures) == arguments.all:
        refuse("FIGURE", "labels of figures, or --all", "both" if arguments.all else "neither", "--list shows them.")
    out = arguments.out
    if out is None and not arguments.check:
        out = "."
    results = gx.reproduce.one_by_one(
        arguments.figures or None, out, arguments.check, gx.plots, dict(map(_setting, arguments.set))
    )
    code = 0
    for result in results:
        wrong = result.failure or result.unwritten or arguments.check and result.passed is False
        said = say(str(result))
        if said == UNREAD:
            return said
        code = code or said or int(bool(wrong))
    return code


def _setting(text):
    name, equals, value = text.partition("=")
    if not name or not equals or not value:
        refuse("--set", "NAME=VALUE", repr(text))
    return name, value
