"""Periodic orbits that granjax did not compute: where they were made, and the lattices they belong to.

`benchmarks/references/orbits.py` makes `known_orbits.json`: SciPy's DOP853 (rtol 1e-13, restarted where a contact
opens or closes), tangents by the variational equation, Newton's method in NumPy, and a correction by an extrapolation
method in 80-bit numbers, whose size is the stated error. All contacts have A = F0 = 1.

| name | what | known from elsewhere |
|---|---|---|
| light_centred | breather of the review's dimer at 0.92 omega_2, 41 beads, free ends, contacts open | E = 2.341574 |
| family | the same at 0.985 omega_2, 25 beads, contacts closed: a point of its family | |
| hard_pair | u'' = -u - u^3 + C D2 u, C = 0.02, omega = 3, sites 3 and 4 of 7 in antiphase | multiplier 1.260834 |
| defect | light bead of mass 1/2 in the middle of 15 between walls, omega = 2.6, contacts open | |
| forced_opening | 6 beads, the left wall shaken by 0.9 cos 1.2 t, damping 0.1, contacts open | |
| forced_branch | 3 beads, both walls by 0.03 in antiphase at 1.68, damping 0.02: the lower, stable orbit | |
| forced_branch_upper | the same on the upper fold, unstable, contacts open | |
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

import granjax as gx

HEAVY = 2.957949


class Reference(NamedTuple):
    """An orbit at t = 0 of a lattice, (u, v) known to `error`, energy and multipliers (2N,) to theirs."""

    lattice: gx.Lattice
    omega: float
    u: np.ndarray
    v: np.ndarray
    error: float
    energy: float
    energy_error: float
    multipliers: np.ndarray
    multiplier_errors: np.ndarray
    opened: bool


def dimer(sites):
    """The review's: light mass 1 in the middle, heavy 2.957949; Theocharis et al., Phys. Rev. E 82, 056604 (2010)."""
    light = (np.arange(sites) - sites // 2) % 2 == 0
    return gx.Lattice(
        np.where(light, 1.0, HEAVY), (gx.Bond(gx.Shift(1, "free"), gx.Hertz(1.0, 1.0)),)
    )


def hard(sites=7, coupling=0.02):
    """u'' = -u - u^3 + C D2 u with free ends."""
    terms = (
        gx.Bond(gx.Shift(1, "free"), gx.Linear(coupling)),
        gx.OnSite(gx.Polynomial(1.0, 0.0, 1.0)),
    )
    return gx.Lattice(np.ones(sites), terms)


def shaken(sites, amplitude, omega, damping, **keywords):
    """Beads between walls that move."""
    chain = gx.scenes.monomer(sites, precompression=1.0)
    return gx.driven.driven_chain(chain, amplitude, omega, damping=damping, **keywords)


LATTICES = {
    "light_centred": lambda: dimer(41),
    "family": lambda: dimer(25),
    "hard_pair": hard,
    "defect": lambda: gx.scenes.defects(15, {7: 0.5}, precompression=1.0),
    "forced_opening": lambda: shaken(6, 0.9, 1.2, 0.1, ends="left"),
    "forced_branch": lambda: shaken(3, 0.03, 1.68, 0.02, phase=(0.0, np.pi)),
    "forced_branch_upper": lambda: shaken(3, 0.03, 1.68, 0.02, phase=(0.0, np.pi)),
}


def reference(name):
    """The `Reference` of that name."""
    data = json.loads(Path(__file__).with_suffix(".json").read_text())[name]
    for key in ("u", "v", "multiplier_errors"):
        data[key] = np.array(data[key])
    data["multipliers"] = np.array(data["multipliers"]) @ [1, 1j]
    return Reference(LATTICES[name](), **data)
