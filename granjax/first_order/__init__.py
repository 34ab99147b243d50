"""First-order lattices i dpsi/dt = dH/dpsi*: DNLS, Salerno's, discrete p-Schroedinger.

They are complex vector fields f(t, psi, args) for `gx.Flow` and diffrax; `args` is the equation:

    import numpy as np

    equation = gx.first_order.DNLS(16, coupling=1.0, nonlinearity=3.0, order=0.5)
    psi = np.eye(16)[8] + 0j
    run = gx.first_order.evolve(equation, psi, 20.0, save_at=200)
    flow = gx.Flow(100, gx.first_order.SplitStep(), gx.first_order.field)
    end = flow(psi, 0.0, 20.0, equation)
"""

from .equations import DNLS, DpS, Equation, Salerno, electrical, field, tau_0
from .evolution import Evolution, evolve
from .solitons import Soliton, soliton
from .split_step import SplitStep
from .stability import SolitonFamily, SolitonStability, soliton_family, stability
from .trapping import SelfTrapping, self_trapping
