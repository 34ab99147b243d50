"""Magnets that collide: a dispersive shock without contact

Two halves of a chain of repelling magnets move towards each other. An undular bore runs out from the middle in both
directions, led by nearly solitary waves. Between the two bores the magnets come to rest, closer together.

:systems: shock waves of magnets
:part: Beyond the granular chain
:number: mean strain between the two shocks, c = 0.1, F = d^(-3)
:expected: 0.103517
:within: 0.1 %
:source: 1 - 1/(1 + 2c/sqrt3), a simple wave; Li, Chockalingam, Cohen, Phys. Rev. Lett. 127, 014302 (2021) on magnets
"""

import matplotlib.pyplot as plt

import granjax as gx

chain = gx.scenes.monomer(180, exponent=-3.0, precompression=1.0, boundary="free")
run = gx.shocks.velocity_shock(chain, 0.1).run(34.0)
shock = gx.shocks.measure(run)
number = float(shock.mean)
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
gx.plots.shock(run, shock, ax)
