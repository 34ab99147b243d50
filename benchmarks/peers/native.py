"""The splitting loop in C (`kernel.c`), compiled for this machine where a compiler is there."""

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from granjax.solvers import tables

from .chain import SPLITTING, Unfit

PARAMETER = "step"
SOURCE = Path(__file__).with_name("kernel.c")
# compiled apart from linking: gcc would link -ffast-math's start-up code, which changes the whole process's arithmetic
COMPILE = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-c")
LINK = ("-shared",)


def calls(chain):
    """All splitting methods; a batch as one chain after the other."""
    library = _library()
    run = _batch if chain.batch else _one
    return {f"C {name}": run(chain, tables.splitting(name), library) for name in SPLITTING}


def compiler():
    """The C compiler's name, or `None`."""
    return os.environ.get("CC") or next(
        (name for name in ("gcc", "clang", "cc") if shutil.which(name)), None
    )


@cache
def _library():
    name = compiler()
    if name is None:
        raise Unfit("no C compiler on this machine")
    with tempfile.TemporaryDirectory() as folder:
        middle = Path(folder) / "kernel.o"
        path = Path(folder) / "kernel.so"
        for command in (
            [name, *COMPILE, str(SOURCE), "-o", str(middle)],
            [name, *LINK, str(middle), "-o", str(path)],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise Unfit(f"{name} failed: {done.stderr.strip()[-200:]}")
        # stays loaded when the file is gone
        library = ctypes.CDLL(str(path))
    P = ctypes.c_void_p
    I = ctypes.c_long
    D = ctypes.c_double
    library.chain.argtypes = [P, P, P, I, I, D, D, D, D, D, P, P, I]
    library.batch.argtypes = [P, P, P, I, I, I, D, D, D, D, P, P, P, I]
    return library


def _one(chain, table, library):
    c = chain.single("the C loop")
    a = table.a.ctypes.data
    b = table.b.ctypes.data

    def call(steps):
        u = c.u.copy()
        v = c.v.copy()
        f = np.empty(c.u.size + 1)
        library.chain(
            u.ctypes.data,
            v.ctypes.data,
            f.ctypes.data,
            u.size,
            steps,
            c.t1 / steps,
            c.stiffness,
            c.overlap,
            c.force,
            c.inverse_mass,
            a,
            b,
            table.a.size,
        )
        return u, v

    return call


def _batch(chain, table, library):
    us, vs, inverse = (np.ascontiguousarray(x.T) for x in (chain.u, chain.v, chain.inverse_mass))
    a = table.a.ctypes.data
    b = table.b.ctypes.data

    def call(steps):
        u = us.copy()
        v = vs.copy()
        f = np.empty(us.shape[1] + 1)
        library.batch(
            u.ctypes.data,
            v.ctypes.data,
            f.ctypes.data,
            *u.shape,
            steps,
            chain.t1 / steps,
            chain.stiffness,
            chain.overlap,
            chain.force,
            inverse.ctypes.data,
            a,
            b,
            table.a.size,
        )
        return u.T, v.T

    return call
