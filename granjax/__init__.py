"""granjax: a differentiable simulator of nonlinear lattices on JAX.

`import granjax as gx` is enough. It switches float64 on unless the environment holds JAX_ENABLE_X64, and sets two XLA
flags that speed up its loops on the CPU unless it holds GRANJAX_TUNE=0; `gx.tune()` says what is in force.
"""

from . import interrupts as _interrupts

# before what takes seconds to import
if _interrupts.is_command():
    _interrupts.prepare_command()

from . import tuning as _tuning

_tuning.prepare_import()
_interrupts.prepare_python()

from . import laws, strains, terms  # noqa: E402
from .design import Design, design, smooth_peak  # noqa: E402
from .fit import Fit, Traces, fit  # noqa: E402
from .flow import (  # noqa: E402
    Arrival,
    Derivative,
    Flow,
    Integral,
    Lowest,
    Peak,
    Record,
    Reversible,
    Run,
    derivative,
    simulate,
)
from .lattice import Lattice, State, vector_field  # noqa: E402
from .laws import Hertz, Law, Linear, Network, Polynomial, PowerLaw, Sine, Spline, Toda, Yielding  # noqa: E402
from .solvers import (  # noqa: E402
    RKN86,
    RKN1210,
    KahanLi8,
    SofroniouSpaletta10,
    SRKN6b,
    SRKN11b,
    SRKN14a,
    VelocityVerlet,
)
from .strains import Pairs, Shift, StrainMap, Stretch  # noqa: E402
from .terms import (  # noqa: E402
    Bond,
    Breaks,
    Damping,
    Dashpot,
    Drag,
    Drive,
    Harmonic,
    Modulated,
    OnSite,
    Term,
    ViscousContact,
    Wall,
)
from .tuning import clear, tune  # noqa: E402
from .units import Units  # noqa: E402
from .work_precision import WorkPrecision, work_precision  # noqa: E402

__version__ = "0.1.0"
_LAZY = {
    name: f".{name}" for name in (
        "breathers", "canonical", "continuation", "driven", "floquet", "forced", "identify", "linear", "materials",
        "measures", "newton", "orbits", "plots", "scenes", "states", "studies", "theory", "travelling",
    )
} | {"reproduce": ".studies.reproduce", "resonance": ".studies.resonance"}


def __getattr__(name):
    """Submodules that are loaded when first asked for, so that import stays quick."""
    if name in _LAZY:
        import importlib

        return importlib.import_module(_LAZY[name], __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted([*globals(), *_LAZY])
