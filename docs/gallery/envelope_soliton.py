"""An envelope soliton: the sech of the NLS equation on a lattice

On a chain whose contacts soften, the bright soliton of the NLS equation (line) oscillates above the band and stays
where it is. After 100 periods the strains (dots) still fill this envelope.

:systems: envelope solitons (NLS)
:part: Breathers
:number: frequency of the middle bond over 100 periods, over that of the band's edge
:expected: 1.001
:within: 0.00006
:source: kappa = nu3 |Y|^2/2 of the soliton; Huang, Hu, Phys. Rev. B 57, 5746 (1998)
"""

import matplotlib.pyplot as plt
import numpy as np

import granjax as gx

chain = gx.scenes.foam(201, 0.5, boundary="free")
edge = 2**0.5
envelope = gx.theory.nls.coefficients(1.0, *gx.laws.taylor(chain.terms[0].law), np.pi)
soliton = gx.theory.nls.bright_profile(envelope, 1.001 * edge, 201)
run = gx.simulate(
    chain,
    gx.State(soliton.displacement, chain.zeros()),
    100 * 2 * np.pi / (1.001 * edge),
    save_at=2001,
)
middle = run.us[:, 100] - run.us[:, 100].mean() - 1j * run.vs[:, 100] / edge
number = float(np.polyfit(run.ts, np.unwrap(np.angle(middle)), 1)[0] / edge)
x = np.arange(200) - 99.5
ax = plt.subplots(figsize=(5.4, 3.2), layout="constrained")[1]
ax.plot(x, gx.measures.strain(chain, run.final), "o", ms=3)
for sign in (-1, 1):
    ax.plot(x, sign * 2 * soliton.amplitude / np.cosh(soliton.inverse_width * x), "C1")
ax.set(xlabel="contact from the middle", ylabel="strain (scaled)")
