"""Toda's chain: two solitons pass through each other

A fast soliton overtakes a slow one. Both leave the collision with their shape unchanged. The only effect is a shift:
the fast soliton is ahead of where it would be alone, and the slow one behind.

:systems: Toda chain, collisions of solitary waves
:part: Lattices
:number: shift of the fast soliton along the chain, in contacts
:expected: 0.70380298
:within: 1e-6
:source: Toda, J. Phys. Soc. Jpn. 22, 431 (1967): ln[sinh((k1 + k2)/2)/sinh((k1 - k2)/2)]/k1, k1 = 2, k2 = 1
"""

import matplotlib.pyplot as plt

import granjax as gx

fast, slow = (
    gx.travelling.solitary_wave(gx.Toda(), speed=gx.theory.toda.speed(k)) for k in (2.0, 1.0)
)
found = gx.travelling.collide(fast, slow, tolerance=1e-4)
number = float(found.shifts[0])
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(found.run, ax)
ax.set_title(f"the fast one is {number:.4f} contacts ahead")
