"""Packets in disordered Klein-Gordon chains: `python spreading.py` writes spreading.csv, some 25 min.

H = sum p^2/2 + e u^2/2 + u^4/4 + (u_{l+1} - u_l)^2/(2 W), e even in [1/2, 3/2], W = 4; at first one site has all
energy, 0.4, in its velocity. A tangent beside each chain tells how fast near-by motions part.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import granjax as gx

SITES = 256
LANES = 64
SEED = 0
STRENGTH = 4.0
ENERGY = 0.4
STEP = 0.5
SOLVER = gx.ABA864()
# a few times each decade up to the end
TIMES = np.unique(np.round(2 * 10 ** np.arange(2.0, 6.01, 0.125)))
# after which a tangent is at the latest made short again
PIECE = 5e4


def chains(draw):
    def one(stiffness):
        law = gx.Polynomial(stiffness, 0.0, 1.0)
        return gx.scenes.klein_gordon(SITES, 1 / STRENGTH, law=law, boundary="fixed")

    return jax.vmap(one, out_axes=-1)(jnp.asarray(draw.uniform(0.5, 1.5, (LANES, SITES))))


@jax.jit
def second_moment(lattice, y):
    """Of the energy's distribution over the sites, for each lane."""
    energy = gx.measures.site_energy(lattice, y)
    share = energy / energy.sum(0)
    site = jnp.arange(SITES)[:, None]
    return ((site - (share * site).sum(0)) ** 2 * share).sum(0)


@jax.jit
def moved(lattice, y, w, span, steps):
    """The state, the tangent at length one, and the logarithm of its growth."""
    y, w = gx.Flow(steps, SOLVER).tangents(y, w, 0.0, span, lattice)
    size = jnp.sqrt((w.u**2 + w.v**2).sum((0, 2)))
    return y, gx.State(w.u / size[:, None], w.v / size[:, None]), jnp.log(size)


def main():
    draw = np.random.default_rng(SEED)
    lattice = chains(draw)
    zero = lattice.zeros()
    y = gx.State(zero, zero.at[SITES // 2].set((2 * ENERGY) ** 0.5))
    w = gx.State(zero[..., None], jnp.asarray(draw.normal(size=(*zero.shape, 1))))
    w = moved(lattice, y, w, STEP, 1)[1]
    begin = lattice.energy(0.0, *y)
    t = 0.0
    growth = 0.0
    lines = ["time,lane,second_moment,growth"]
    for end in TIMES:
        while t < end:
            span = min(end - t, PIECE)
            y, w, more = moved(lattice, y, w, span, round(span / STEP))
            t = t + span
            growth = growth + np.asarray(more)
        m2 = np.asarray(second_moment(lattice, y))
        lines += [f"{t:.0f},{i},{m2[i]:.5g},{growth[i]:.5g}" for i in range(LANES)]
        drift = float(jnp.max(jnp.abs(lattice.energy(0.0, *y) / begin - 1)))
        print(f"t {t:.0f}, m2 {np.exp(np.log(m2).mean()):.4g}, energy to {drift:.1g}", flush=True)
    Path(__file__).with_suffix(".csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
