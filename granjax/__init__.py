"""granjax: a differentiable simulator of nonlinear lattices on JAX."""

from . import tuning as _tuning

_tuning.prepare_import()

from . import laws, strains, terms
from .lattice import Lattice, State, vector_field
from .laws import Hertz, Linear, Polynomial, PowerLaw, Sine, Toda, Yielding
from .strains import Pairs, Shift, Stretch
from .solvers import KahanLi8, SofroniouSpaletta10, SRKN6b, SRKN11b, SRKN14a, VelocityVerlet
from .terms import Bond, Damping, Dashpot, Drive, Harmonic, Modulated, OnSite, Wall
from .tuning import tune

__version__ = "0.1.0"
