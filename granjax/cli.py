"""The command line: `granjax resonance`.

The result goes to standard output, everything else to standard error. Exit codes: 0; 1 where a
computation failed; 2 for input that cannot be meant or a file that cannot be written, with a
sentence; 130 where the command was interrupted.
"""

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import granjax as gx

from .checks import whole
from .files import folder, netcdf, target, write
from .tuning import cores, keep_compiled

LEAST_RATIOS = 3
LOWEST_RATIO = 0.05
# the exit code of a process that Ctrl-C ended
INTERRUPTED = 130
# pages of the documentation by their titles, which hold for an installed package too
START = "See the page 'Start here'."
OUTCOMES = "See the page 'Errors, outcomes and verdicts'."
ABOUT = """
Simulates nonlinear lattices: granular crystals, FPUT, Toda and magnetic chains,
crystals in the plane. In Python `import granjax as gx` has all of it; from here
you compute a known curve.
""".strip()
COMMANDS = f"""
one command, with an example:
  resonance   how much of a pulse a struck dimer chain lets through to a wall,
              over its mass ratio, with its resonances
                  granjax resonance --out results

granjax resonance --help says more. {START}
""".strip()
EXAMPLES = f"""
examples:
  granjax resonance
  granjax resonance --beads 41 --ratios 50 --out short.png

{START}
""".strip()
DEFINITION = (
    "largest force on a rigid wall behind a struck 1:1 dimer chain (heavy bead first, Hertz contacts, no "
    "precompression) over that of the monomer chain"
)


def command() -> NoReturn:
    """Run the process `granjax`."""
    try:
        code = main()
    except SystemExit as end:  # of --help and --version
        code = end.code or 0
    sys.stdout.flush()
    # threads of XLA may still be at work, and Python would wait for them
    os._exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; `argv` without the program's name, `None` for that of the process. Returns the exit code."""
    try:
        arguments = _parser().parse_args(argv)
        if arguments.command is None:
            _parser().print_help()
            return 0
        _prepare(not arguments.no_cache)
        arguments.command(arguments)
        return 0
    except ValueError as error:
        return _complain(error, 2, START)
    except OSError as error:
        return _complain(error, 2)
    except RuntimeError as error:
        return _complain(error, 1, OUTCOMES)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)


def _complain(error, code=0, page=""):
    """The exit code; the sentence goes to standard error, with a page where it names none."""
    said = str(error) if "See the page '" in str(error) else f"{error} {page}".strip()
    print(f"granjax: {said}", file=sys.stderr, flush=True)
    return code


class _Parser(argparse.ArgumentParser):
    def __init__(self, *arguments, **keywords):
        keywords["formatter_class"] = argparse.RawDescriptionHelpFormatter
        super().__init__(*arguments, **keywords)

    def error(self, message):
        raise ValueError(f"{message}. {START.rstrip('.')}, or {self.prog} --help.")


def _parser():
    usage = "granjax [-h] [--version] [--no-cache] COMMAND ..."
    parser = _Parser(prog="granjax", usage=usage, description=ABOUT, epilog=COMMANDS)
    parser.add_argument("--version", action="version", version=f"granjax {gx.__version__}")
    parser.add_argument(
        "--no-cache",
        action="store_true",
        help="compile anew; otherwise programs are kept in your cache folder (or in the folder GRANJAX_CACHE)",
    )
    parser.set_defaults(command=None)
    commands = parser.add_subparsers(prog="granjax", metavar="COMMAND", help=argparse.SUPPRESS)
    text = "Transmission of a struck dimer chain to a wall over the mass ratio:\npicture, data, resonances."
    resonance = commands.add_parser("resonance", description=text, epilog=EXAMPLES)
    resonance.add_argument(
        "--beads", type=int, default=101, help="beads of the chain, 3 or more (default: 101)"
    )
    resonance.add_argument(
        "--ratios",
        type=int,
        default=200,
        metavar="N",
        help=f"mass ratios in ({LOWEST_RATIO:g}, 1], {LEAST_RATIOS} or more (default: 200)",
    )
    resonance.add_argument(
        "--out",
        default=".",
        metavar="PLACE",
        help="folder for resonance.png and resonance.nc, or a path ending in .png or .nc for other names",
    )
    resonance.add_argument(
        "--json", action="store_true", help="print one JSON object instead of a table"
    )
    resonance.set_defaults(command=_resonance)
    return parser


def _prepare(cache):
    """XLA's flags, one device per core, and the cache of compiled programs, before JAX's first computation."""
    import jax

    if cache:
        keep_compiled()
    tuning = gx.tune()
    if not tuning.complete and os.environ.get("GRANJAX_TUNE", "1") != "0":
        _complain(tuning.outcome)
    chosen = "xla_force_host_platform_device_count" in tuning.flags
    if not chosen and jax.config.jax_num_cpu_devices <= 0:
        # where JAX has started already the cores stay as they are shared
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", cores())


def _resonance(arguments):
    """How much of an impact dimer chains let through to a wall, over the mass ratio."""
    import numpy as np

    remedy = "An extremum lies between two others."
    count = whole("--ratios", arguments.ratios, LEAST_RATIOS, remedy)
    beads = whole("--beads", arguments.beads, 3, "A dimer chain between walls.")
    out = Path(arguments.out)
    stem = out.with_suffix("") if out.suffix in (".png", ".nc") else out / "resonance"
    folder("--out", stem.parent)
    picture, data = (target("--out", f"{stem}{ending}") for ending in (".png", ".nc"))
    ratios = np.linspace(LOWEST_RATIO, 1, count + 1)[1:]
    sweep = gx.resonance.transmission(ratios, beads)
    extrema = gx.resonance.refine(sweep)
    write(data, _data(sweep, extrema))
    write(picture, _picture(sweep, extrema))
    if arguments.json:
        columns = {
            "mass_ratio": sweep.mass_ratio,
            "transmission": sweep.transmission,
            "resonances": extrema.resonances,
            "anti_resonances": extrema.anti_resonances,
        }
        print(json.dumps({name: column.tolist() for name, column in columns.items()}))
    else:
        print("\n".join(_table(sweep, extrema)))
        print(f"Written: {picture}, {data}")


def _picture(sweep, extrema):
    # the extrema among the points, so that cusps are sharp
    places = [(x, T) for x, T, _ in _rows(extrema)]
    ratios, values = zip(*places, *zip(sweep.mass_ratio, sweep.transmission))
    with gx.plots.style():
        canvas = gx.plots.figure(6.4, 4.0)
        gx.plots.transmission(
            ratios,
            values,
            canvas.subplots(),
            resonances=extrema.resonances,
            anti_resonances=extrema.anti_resonances,
        )
        return gx.plots.drawn(canvas, ".png")


def _data(sweep, extrema):
    data = sweep.to_xarray().merge(extrema.to_xarray(), combine_attrs="drop_conflicts")
    data.attrs |= {
        "definition": DEFINITION,
        "granjax_version": gx.__version__,
        "units": "mass of the heavy bead m = 1, contact stiffness A = 1, striker's velocity v = 1",
    }
    return netcdf(data)


def _rows(extrema):
    """(mass ratio, transmission, what it is), sorted."""
    kinds = (
        ("resonance", extrema.resonances, extrema.resonance_transmission),
        ("anti-resonance", extrema.anti_resonances, extrema.anti_resonance_transmission),
        ("local extremum", extrema.local_extrema, extrema.local_transmission),
    )
    return sorted((x, T, kind) for kind, places, values in kinds for x, T in zip(places, values))


def _table(sweep, extrema):
    yield f"Dimer chain of {sweep.beads} beads and a wall, {len(sweep.mass_ratio)} mass ratios."
    yield "mass ratio  transmission"
    for x, T, kind in _rows(extrema):
        yield f"{x:10.4f}  {T:12.4f}  {kind}"
    known = ", ".join(f"{x:g}" for x in gx.resonance.ANTI_RESONANCES)
    yield f"Literature: first resonance {gx.resonance.FIRST_RESONANCE:g}; anti-resonances {known}."
    yield (
        "Those anti-resonances are zeros of the asymptotic decay rate, which the maxima of a chain of "
        f"{sweep.beads} beads have not reached yet; gx.resonance.anti_resonance(low, high) finds them."
    )
