"""The command line: `granjax resonance`.

Results go to standard output, everything else to standard error, or to standard output where
that is closed. Exit codes: 0; 1 where a computation failed or a result could not be written to its
place; 2 for input that cannot be meant, with a sentence; 130 where it was interrupted; 141 where
nobody reads standard output any more.
"""

import argparse
import os
import warnings
from collections.abc import Sequence
from typing import NoReturn

import granjax as gx

from ..tuning import cores, keep_compiled
from .output import OUTCOMES, START, complain, pointed, say, see
from .resonance import add_resonance

ABOUT = """
Simulates nonlinear lattices: granular crystals, FPUT, Toda and magnetic chains,
crystals in the plane. In Python `import granjax as gx` has all of it; from here
you compute a known curve.
""".strip()
# the exit code of a process that Ctrl-C ended
INTERRUPTED = 130
COMMANDS = f"""
one command, with an example:
  resonance   how much of a pulse a struck dimer chain lets through to a wall,
              over its mass ratio, with its resonances
                  granjax resonance --out results

granjax resonance --help says more. {see(START)}
""".strip()


def command() -> NoReturn:
    """Run the process `granjax`."""
    try:
        code = main()
    except SystemExit as end:  # of --help and --version
        code = end.code or say("")
    # threads of XLA may be at work still, and what could not be written would be tried again
    os._exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; `argv` without the program's name, `None` for that of the process. Returns the exit code."""
    try:
        arguments, extra = _parser().parse_known_args(argv)
        if extra:
            raise ValueError(f"unrecognized arguments: {' '.join(extra)}.")
        if arguments.command is None:
            return say(_parser().format_help().rstrip())
        _prepare(not arguments.no_cache)
        return arguments.command(arguments)
    except ValueError as error:
        return complain(pointed(error, START), 2)
    except OSError as error:
        return complain(error, 2)
    except RuntimeError as error:
        return complain(pointed(error, OUTCOMES), 1)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


class _Parser(argparse.ArgumentParser):
    def __init__(self, *arguments, formatter_class=None, **keywords):
        super().__init__(
            *arguments, formatter_class=argparse.RawDescriptionHelpFormatter, **keywords
        )

    def error(self, message):
        raise ValueError(f"{message}. {see(START).rstrip('.')}, or {self.prog} --help.")


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
    add_resonance(parser.add_subparsers(prog="granjax", metavar="COMMAND", help=argparse.SUPPRESS))
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
    chosen = (
        "xla_force_host_platform_device_count" in tuning.flags or jax.config.jax_num_cpu_devices > 0
    )
    if not chosen:
        try:
            jax.config.update("jax_num_cpu_devices", cores())
        except RuntimeError:
            complain("JAX has started already, so the cores stay as they are shared.")
