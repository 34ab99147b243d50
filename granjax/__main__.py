"""The command line: `granjax resonance` computes the transmission of dimer chains.

Exit codes: 0; 1 if a computation failed; 2 for invalid input or a file that cannot be written, with
a sentence.
"""

import argparse
import contextlib
import os
from collections.abc import Sequence

import jax
import numpy as np

import granjax as gx

from .base.checks import whole
from .base.files import folder, netcdf, write
from .base.tuning import cores, keep_compiled

ABOUT = "In Python `import granjax as gx` has all of granjax; from here you compute a known curve."
RESONANCE = (
    "Transmission of a struck dimer chain to a wall over the mass ratio: resonance.png, resonance.nc, "
    "and the resonances as a table."
)
# The mass ratios of the curve begin above this one and end at 1.
LOWEST_RATIO = 0.05
DEFINITION = (
    "largest force on a rigid wall behind a struck 1:1 dimer chain (heavy bead first, Hertz contacts, no "
    "precompression) over that of the monomer chain"
)
UNITS = "mass of the heavy bead m = 1, contact stiffness A = 1, striker's velocity v = 1"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code.

    `argv` excludes the program's name; `None` takes the arguments of the process.
    """
    parser = argparse.ArgumentParser("granjax", description=ABOUT)
    parser.add_argument("--version", action="version", version=f"granjax {gx.__version__}")
    commands = parser.add_subparsers(dest="command")
    command = commands.add_parser("resonance", help=RESONANCE, description=RESONANCE)
    add = command.add_argument
    add("--beads", type=int, default=101, help="beads of the chain, 3 or more (%(default)s)")
    add("--ratios", type=int, default=200, help="mass ratios in (0.05, 1], 3 or more (%(default)s)")
    add("--out", default=".", help="folder for the picture and the data (this one)")
    arguments = parser.parse_args(argv)
    if arguments.command is None:
        parser.print_help()
        return 0
    try:
        _resonance(arguments)
    except (ValueError, OSError) as error:
        command.error(str(error))
    return 0


def _resonance(arguments):
    count = whole("--ratios", arguments.ratios, 3, "An extremum lies between two others.")
    beads = whole("--beads", arguments.beads, 3, "A dimer chain between walls.")
    place = folder("--out", arguments.out)
    keep_compiled()
    chosen = "host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if not chosen and jax.config.jax_num_cpu_devices <= 0:
        with contextlib.suppress(RuntimeError):  # Once JAX has started, its devices stay.
            jax.config.update("jax_num_cpu_devices", cores())
    sweep = gx.resonance.transmission(np.linspace(LOWEST_RATIO, 1, count + 1)[1:], beads)
    extrema = gx.resonance.refine(sweep)
    kinds = (
        ("resonance", extrema.resonances, extrema.resonance_transmission),
        ("anti-resonance", extrema.anti_resonances, extrema.anti_resonance_transmission),
        ("local extremum", extrema.local_extrema, extrema.local_transmission),
    )
    rows = sorted((x, T, kind) for kind, places, values in kinds for x, T in zip(places, values))
    data = sweep.to_xarray().merge(extrema.to_xarray(), combine_attrs="drop_conflicts")
    data.attrs |= {"definition": DEFINITION, "units": UNITS, "granjax_version": gx.__version__}
    write(place / "resonance.nc", netcdf(data))
    write(place / "resonance.png", _picture(sweep, extrema, rows))
    print(f"Dimer chain of {beads} beads and a wall, {count} mass ratios.")
    print("mass ratio  transmission")
    for x, T, kind in rows:
        print(f"{x:10.4f}  {T:12.4f}  {kind}")
    known = ", ".join(f"{x:g}" for x in gx.resonance.ANTI_RESONANCES)
    print(
        f"Literature: first resonance {gx.resonance.FIRST_RESONANCE:g}; anti-resonances {known}.\n"
        "Those anti-resonances are zeros of the asymptotic decay rate, which the maxima of a chain "
        f"of {beads} beads have not reached yet; gx.resonance.anti_resonance(low, high) finds them."
    )


def _picture(sweep, extrema, rows):
    # The extrema are added to the points, so that cusps are sharp.
    ratios = np.append(sweep.mass_ratio, [x for x, _, _ in rows])
    values = np.append(sweep.transmission, [T for _, T, _ in rows])
    marks = {"resonances": extrema.resonances, "anti_resonances": extrema.anti_resonances}
    with gx.plots.style():
        canvas = gx.plots.figure(6.4, 4.0)
        gx.plots.transmission(ratios, values, canvas.subplots(), **marks)
        return gx.plots.drawn(canvas, ".png")


if __name__ == "__main__":
    raise SystemExit(main())
