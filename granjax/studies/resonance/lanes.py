"""Peak contact forces of many dimer chains: the sweep of `transmission.toml` with other numbers.

A chunk has eight lanes: one vector of float64, and its step follows its own stiffest lane. All calls share one
compiled program.
"""

import copy
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...checks import refuse, show, within
from ...sweeps import sweep
from ...sweeps.file import recipe_of, tables
from ...types import Count, Parameter, Scalar

LANES = 8
FILE = Path(__file__).with_name("transmission.toml")


def checked_ratios(ratios: Parameter) -> Float[np.ndarray, " n"]:
    """Mass ratios as a NumPy array (n,), each in (0, 1]."""
    ratios = np.asarray(within("ratios", ratios, 0, 1, open_low=True, remedy="The ratio is light over heavy."), float)
    if ratios.ndim != 1 or not ratios.size:
        refuse("ratios", "a list of mass ratios", f"shape {ratios.shape}", f"For one: [{show(ratios)}].")
    return ratios


def peak_forces(
    ratios: Float[np.ndarray, " n"], beads: Count, boundary: str, bonds: tuple[int, ...], t1: Scalar,
    progress: bool = False,
) -> Float[np.ndarray, "bonds n"]:
    """Largest forces of some bonds until t1, shape (bonds, n); NaN for a run that did not complete.

    **Arguments:** `ratios` (n,), checked; `bonds`: a tuple of indices into the chain's bonds.
    """
    said = copy.deepcopy(_file())
    said["scene"] |= {"sites": int(beads), "boundary": boundary}
    said["vary"] = {"ratio": ratios.tolist(), "run.until": [float(t1)] * len(ratios)}
    said["design"] = {"kind": "paired"}
    said["record"] = {"force": {"kind": "peak", "of": "contact_force", "bond": list(bonds)}}
    said["result"] = {"chunk": LANES}
    asked = recipe_of(said)
    data = sweep(asked.function, asked.parameters, chunk=asked.chunk, progress=progress)
    return data["force"].values.T


@cache
def _file():
    return tables(FILE)
