"""Peak contact forces of many dimer chains: lanes in chunks, chunks on devices.

A chunk has eight lanes: one vector of float64, as fast per lane as 64 and twice as fast as 16, and its step follows
its own stiffest lane. A call takes one chunk to every device; devices do not talk to each other, and all calls share
one compiled program.
"""

from collections.abc import Iterable
from functools import cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Float

from ...checks import refuse, show, within
from ...flow import Peak, simulate
from ...measures import contact_force
from ...programs import wait
from ...scenes import dimer
from ...states import impact
from ...types import Count, Parameter, Scalar

LANES = 8


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
    """Largest forces of some bonds until t1, shape (bonds, n); NaN for a chunk whose run did not complete.

    **Arguments:** `ratios` (n,), checked; `bonds`: a tuple of indices into the chain's bonds.
    """
    order = np.argsort(ratios, kind="stable")
    devices = tuple(jax.devices()[: -(-len(ratios) // LANES)])
    width = LANES * len(devices)
    # sorted, so that lanes of a chunk are about equally stiff; filled up with the softest
    padded = np.pad(ratios[order], (0, -len(ratios) % width), mode="edge").reshape(-1, width)
    program = _program(beads, boundary, bonds, devices)
    done = list(map(np.asarray, _one_ahead(program, followed(padded, progress, "mass ratios"), float(t1))))
    forces = np.empty((len(bonds), len(ratios)))
    forces[:, order] = np.concatenate(done, axis=1)[:, : len(ratios)]
    return forces


def _one_ahead(program, chunks, t1):
    """Forces of each chunk, while the next one is at work: no more, since an interrupt leaves what has begun."""
    coming = None
    for chunk in chunks:
        last, coming = coming, program(chunk, t1)
        if last is not None:
            yield wait(last)
    yield wait(coming)


def followed(chunks: Iterable, progress: bool, what: str) -> Iterable:
    """Chunks of lanes with a bar that names `what`, where somebody watches."""
    if not progress:
        return chunks
    from tqdm import tqdm

    return tqdm(chunks, desc=what, unit="chunk", leave=False, disable=None)


@cache
def _program(beads, boundary, bonds, devices):
    """The compiled program for chunks of ratios (LANES * devices,), one chunk per device."""
    def quantity(t, y, lattice):
        force = contact_force(lattice, y)
        return jnp.stack([force[bond] for bond in bonds])

    def forces(ratios, t1):
        lattice = jax.vmap(lambda ratio: dimer(beads, ratio, boundary=boundary), out_axes=-1)(ratios)
        # ForwardMode: the number of steps is not bounded, so it is no part of the program
        run = simulate(lattice, impact(lattice), t1, record={"peak": Peak(quantity)}, adjoint=diffrax.ForwardMode())
        return jnp.where(run.completed, run.recorded["peak"], jnp.nan)

    mesh = Mesh(np.array(devices), ("lanes",))
    specs = {"in_specs": (Spec("lanes"), Spec()), "out_specs": Spec(None, "lanes")}
    return jax.jit(jax.shard_map(forces, mesh=mesh, check_vma=False, **specs))
