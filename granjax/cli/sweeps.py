"""`granjax sweep FILE.toml`: a sweep that stands in a file, kept chunk by chunk, resumed, on many machines."""

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import granjax as gx

from .. import interrupts
from ..checks import refuse, whole
from ..files import folder, target
from .output import complain, keep, say
from .pages import CLUSTER, FILE, RESUME, closing, see

MOST_WORKERS = 512
# of what a store keeps until it is finished
UNFINISHED = ".chunks"
# seconds that a scheduler has to answer
ANSWER = 10


def add_sweep(commands: Any) -> None:
    """The command's part of the parser."""
    text = "A sweep that stands in a TOML file: scene, what varies, what is recorded;\ntable, picture, data."
    parser = commands.add_parser(
        "sweep", description=text,
        epilog=closing(FILE, "granjax sweep dimer.toml --check", "granjax sweep dimer.toml --resume --out results"),
    )
    parser.add_argument("file", metavar="FILE.toml", help="the sweep; the page below has its tables and keys")
    parser.add_argument("--resume", action="store_true", help="go on with what an interrupted run has kept")
    parser.add_argument("--check", action="store_true", help="say what would be computed, and stop")
    parser.add_argument("--out", default=".", metavar="DIR", help="folder for what [result] names (default: this one)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: threads, one per core)")
    parser.add_argument("--dask", metavar="ADDRESS", help="address of a Dask scheduler, such as tcp://10.0.0.1:8786")
    parser.set_defaults(command=sweep, page=FILE)


def sweep(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit code."""
    from ..sweeps.file import recipe

    if arguments.workers is not None and arguments.dask is not None:
        refuse("--workers", "workers of one's own, or --dask", "both", see(CLUSTER))
    if arguments.workers is not None and whole("--workers", arguments.workers, 1) > MOST_WORKERS:
        refuse("--workers", f"at most {MOST_WORKERS}", str(arguments.workers), see(CLUSTER))
    asked = recipe(arguments.file)
    asked.check()
    if arguments.check:
        return say(str(asked))
    out = folder("--out", arguments.out)
    names = {"store": asked.store, "picture": asked.picture, "table": asked.table}
    places = {key: None if name is None else out / name for key, name in names.items()}
    store = _store(arguments, places["store"])
    for key in ("picture", "table"):
        if places[key] is not None:
            target(f"[result] {key}", places[key])
    with _executor(arguments) as executor, _advised(arguments, store):
        data = gx.sweep(
            asked.function, asked.parameters, store=store, chunk=asked.chunk, executor=executor, units=asked.units,
        )
    return _told(asked, data, places)


def _store(arguments, place):
    """The path of the store; one that is unfinished is gone on with only where that is asked for."""
    if place is None:
        if arguments.resume:
            remedy = '[result] store = "NAME.nc" keeps what is computed.'
            refuse("--resume", "a store in the file", "none", f"{remedy} {see(RESUME)}")
        return None
    begun = place.with_name(place.name + UNFINISHED)
    if begun.exists() and not arguments.resume:
        refuse("[result] store", "a new place", f"{str(place)!r}, which an interrupted run has begun",
               f"--resume goes on with it; remove {str(begun)!r} to begin anew. {see(RESUME)}")
    return target("[result] store", place)


@contextlib.contextmanager
def _advised(arguments, store) -> Iterator[None]:
    """What an interrupt says: how to go on."""
    said = "nothing was kept, as the file names no store"
    if store is not None:
        again = f"granjax sweep {arguments.file} --resume" + f" --out {arguments.out}" * (arguments.out != ".")
        said = f"finished chunks are kept in {str(store) + UNFINISHED}: {again}"
    interrupts.advice.append(said)
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(said) from None
    finally:
        interrupts.advice.remove(said)


@contextlib.contextmanager
def _executor(arguments) -> Iterator[Executor | int | None]:
    if arguments.dask is None:
        # of an interrupt that ends this process at once nothing is told but its line
        sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
        yield arguments.workers
        return
    try:
        from dask.distributed import Client
    except ImportError:
        refuse("--dask", "dask.distributed to be installed", "none", f"pip install 'granjax[cluster]'. {see(CLUSTER)}")
    try:
        client = Client(arguments.dask, timeout=ANSWER)
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        refuse("--dask", "the address of a scheduler that answers", repr(arguments.dask),
               f"{' '.join(str(error).split())[:200]}. {see(CLUSTER)}")
    with client:
        yield client.get_executor()


def _told(asked: Any, data: Any, places: dict[str, Path | None]) -> int:
    """The table on standard output, the files in their places."""
    from ..exchange import formats
    from ..sweeps.table import table

    failed = int((data["reason"] != "").sum())
    marked = f"{failed} of {data['reason'].size} lanes are marked: see their reasons in the table"
    code = complain(marked, 1) if failed else 0
    code = say("\n".join([*[asked.title] * bool(asked.title), table(data)])) or code
    content: dict[str, Callable[[str], bytes]] = {
        "picture": lambda ending: gx.plots.drawn(gx.plots.sweep(data, asked.show), ending),
        "table": lambda ending: formats.content(data, ending),
    }
    kept = []
    for key, make in content.items():
        if places[key] is not None:
            kept.append(keep(places[key], make(places[key].suffix.lower())))
    if places["store"] is not None or kept:
        code = code or max(kept, default=0) or say("Written: " + ", ".join(str(p) for p in places.values() if p))
    return max(code, *kept, 0)
