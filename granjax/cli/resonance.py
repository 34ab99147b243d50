"""`granjax resonance`: how much of an impact dimer chains let through to a wall, over the mass ratio."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import granjax as gx

from ..checks import whole
from ..files import folder, netcdf, target
from .output import START, keep, say, see

LEAST_RATIOS = 3
LOWEST_RATIO = 0.05
DEFINITION = (
    "largest force on a rigid wall behind a struck 1:1 dimer chain (heavy bead first, Hertz contacts, no "
    "precompression) over that of the monomer chain"
)


def add_resonance(commands: Any) -> None:
    """The command's part of the parser."""
    text = "Transmission of a struck dimer chain to a wall over the mass ratio:\npicture, data, resonances."
    examples = (
        "examples:\n  granjax resonance\n  granjax resonance --beads 41 --ratios 50 --out short.png"
    )
    parser = commands.add_parser(
        "resonance", description=text, epilog=f"{examples}\n\n{see(START)}"
    )
    parser.add_argument(
        "--beads", type=int, default=101, help="beads of the chain, 3 or more (default: 101)"
    )
    parser.add_argument(
        "--ratios",
        type=int,
        default=200,
        metavar="N",
        help=f"mass ratios in ({LOWEST_RATIO:g}, 1], {LEAST_RATIOS} or more (default: 200)",
    )
    parser.add_argument(
        "--out",
        default=".",
        metavar="PLACE",
        help="folder for resonance.png and resonance.nc, or a path ending in .png or .nc for other names",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of a table"
    )
    parser.set_defaults(command=resonance)


def resonance(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    import numpy as np

    count = whole(
        "--ratios", arguments.ratios, LEAST_RATIOS, "An extremum lies between two others."
    )
    beads = whole("--beads", arguments.beads, 3, "A dimer chain between walls.")
    picture, data = _places(arguments.out)
    ratios = np.linspace(LOWEST_RATIO, 1, count + 1)[1:]
    watched = sys.stderr is not None
    sweep = gx.resonance.transmission(ratios, beads, progress=watched)
    extrema = gx.resonance.refine(sweep, progress=watched)
    if arguments.json:
        columns = {
            "mass_ratio": sweep.mass_ratio,
            "transmission": sweep.transmission,
            "resonances": extrema.resonances,
            "anti_resonances": extrema.anti_resonances,
        }
        code = say(json.dumps({name: column.tolist() for name, column in columns.items()}))
    else:
        code = say("\n".join(_table(sweep, extrema)))
    kept = [
        keep(data, _data(sweep, extrema)),
        keep(picture, _picture(sweep, extrema, picture.suffix)),
    ]
    if not any(kept) and not arguments.json:
        code = code or say(f"Written: {picture}, {data}")
    return code or max(kept)


def _places(out):
    """Paths of picture and data; their folder is made where it is missing."""
    stem = (
        Path(out).with_suffix("")
        if Path(out).suffix in (".png", ".nc")
        else Path(out) / "resonance"
    )
    folder("--out", stem.parent)
    return target("--out", f"{stem}.png"), target("--out", f"{stem}.nc")


def _picture(sweep, extrema, ending):
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
        return gx.plots.drawn(canvas, ending)


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
