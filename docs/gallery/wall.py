"""A soliton comes back from a rigid wall too early

A wall that holds the last bead reflects Toda's soliton as if the soliton had met its mirror image. It returns
unchanged, but earlier than from a mirror at that bead, because it collides head-on with its image.

:systems: reflection from a wall
:part: Travelling waves
:number: delay of the reflected soliton against a mirror at the last bead, scaled time
:expected: -0.36911197
:within: 1e-6
:source: -ln(cosh k)/sinh k at k = 1, half the head-on shift of equal solitons: Toda, J. Phys. Soc. Jpn. 22, 431
"""

import matplotlib.pyplot as plt

import granjax as gx

wave = gx.travelling.solitary_wave(gx.Toda(), speed=gx.theory.toda.speed(1.0))
found = gx.travelling.reflect(wave, distance=12, step=0.2)
number = float(found.delay)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.space_time(found.run, ax)
