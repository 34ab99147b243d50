"""Gyroscopes on a honeycomb: sound that runs one way around the edge

Beads on a honeycomb are tied to their places, and a gyroscopic force g (v_y, -v_x) acts on each. Masses and springs
alone cannot give a band a Chern number; this force can. In the middle gap of a strip one mode runs along each edge, in
one direction only.

:systems: valley edge modes
:part: Topology and flat bands
:number: Chern number of the two lower bands together
:expected: -1
:within: 1e-9
:source: as many modes cross the gap at an edge, by the bands of the strip
"""

import equinox as eqx
import jax.numpy as jnp

import granjax as gx


class Gyroscopes(gx.Term):
    rate: float

    def force(self, t, u, v, mass):
        turned = {name: jnp.stack([x[..., 1], -x[..., 0]], -1) for name, x in v.items()}
        return {name: self.rate * x for name, x in turned.items()}


def crystal(*size, boundary):
    plain = gx.scenes.honeycomb(*size, boundary=boundary)
    ties = [gx.OnSite(gx.Linear(0.2), field=name) for name in plain.fields]
    terms = (*plain.terms, *ties, Gyroscopes(0.3))
    return eqx.tree_at(lambda lattice: lattice.terms, plain, terms)


number = float(gx.topology.chern(crystal(6, 6, boundary="periodic"), (0, 1)))
strip = gx.linear.ribbon(crystal(4, 16, boundary=("periodic", "free")))
ax = gx.plots.bands(strip)
