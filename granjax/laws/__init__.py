"""Force laws: one bond or one site, elementwise, measured from static equilibrium."""

from .base import Law, Scaled, Strained, Sum, Taylor, taylor
from .contact import Hertz, PowerLaw
from .plastic import Indented, PlasticLaw, Thornton, WaltonBraun
from .power import plus_power
from .smooth import Linear, Polynomial, Sine, Toda
from .spline import Spline
from .yielding import Yielding
