"""granjax: a differentiable simulator of nonlinear lattices on JAX.

`import granjax as gx` enables float64 unless the environment has JAX_ENABLE_X64, and sets an XLA
flag that speeds up loops on the CPU unless it has GRANJAX_TUNE=0; `gx.tune()` reports it.

    chain = gx.scenes.dimer(101, ratio=0.59)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=1.0), 120.0, save_at=400)
    print(run)

Contents (for details, `help(gx.simulate)`):

Scenes
    scenes              lattices: monomer, dimer, defects, disorder, FPUT, Toda, real beads in SI
    states              initial states: impact, rest, modes, packets, steps, random
    materials           steel, brass, PTFE ...; Hertz contact coefficients from moduli and radii
    Units               a lattice's units of mass, length and time, in SI
    units               `BOLTZMANN`
Lattices
    Lattice             masses and terms, m a = sum of forces
    State               displacements and velocities, (u, v)
    vector_field        the equation of motion, for any diffrax solver
    Term                base class of your own terms
    Bond                a strain map and a law between sites
    OnSite              a force of each site's displacement
    Damping             a force -gamma m v
    Dashpot             a force of the rate of a bond
    ViscousContact      a dashpot that acts while a contact is closed
    Drag                a force of the squared velocity
    Langevin            a heat bath: damping and thermal noise
    LongRange           bonds to all neighbours of a chain, weighted by distance
    Drive               a time-dependent force on a site
    BrilliantovContact  viscoelastic spheres without attraction
    CaputoDamping       damping with the history of the velocity
    PlasticContact      contacts that yield, and remember their largest overlap
    Wall                a yielding or moving wall
    Modulated           a term times a function of time
    Harmonic            a cosine of time whose parameters can be swept
    Square              a square wave: layers in time
    Breaks              times at which a function of time jumps
    terms               all terms, and their parts
Strain maps
    Shift               bonds to a neighbour, on chains and grids, between fields of a cell
    Pairs               bonds of any graph
    Stretch             bonds as distances in the plane or in space
    StrainMap           base class of your own strain maps
    strains             all strain maps, and `Stencil`: sums over several sites and fields
Laws
    Hertz               spheres in contact, A d^{3/2}
    PowerLaw            contacts of any exponent, magnets
    Polynomial          FPUT springs
    Toda                exponential springs
    Linear              linear springs
    Sine                sine-Gordon
    Yielding            a contact in series with a spring
    WaltonBraun         a plastic contact, bilinear
    Thornton            a plastic contact of spheres
    PlasticLaw          base class of your own plastic laws
    Spline              a monotone law of free shape
    Law                 base class of your own laws
    laws                all laws, and their Taylor coefficients
Motion
    simulate            integrate a lattice in time
    Run                 its result
    caputo              a vector field with Caputo's derivative in time
    CaputoRun           its result
    RunWithMemory       the result of `simulate` for forces that read the past
    Peak                a record: the largest value, also between steps
    PeakTime            a record: the time of the largest value
    Lowest              a record: the smallest value
    Arrival             a record: the time at which a quantity passes a threshold
    Integral            a record: the integral over time
    Record              base class of your own records
    Reversible          reverse mode with constant memory, by integrating backwards
    derivative          the derivative of a run, with its error
    Derivative          its result
    Flow                the map over a number of steps, with tangents
    first_order         DNLS, electrical lattices, discrete p-Schroedinger; solitons, self-trapping
    fractional          kernel and symbol of the discrete fractional Laplacian
    measures            contact forces, energies, spectra, fronts, localisation of a state or a run
    equilibrium         where a lattice rests, and the loads that hold it
    Equilibrium         its result
    linear              modes, dispersion, bands, speed of sound, paths and strips, flat bands
    topology            Zak phases, winding, Chern and valley numbers, quadrupole
Solvers
    VelocityVerlet      order 2
    SRKN6b              order 4
    ABA864              order 4, seven forces; higher for small perturbations
    SRKN11b             order 6
    SRKN14a             order 6, 14 stages: for orbits
    KahanLi8            order 8
    SofroniouSpaletta10 order 10
    RKN86               order 8, with a tolerance
    RKN1210             order 12, with a tolerance
    solvers             all solvers, and their stability
    work_precision      error against time of several solvers on a lattice
    WorkPrecision       its result
Periodic orbits
    breathers           breathers and their families
    forced              orbits of driven lattices, and their branches
    kinks               kinks between two wells: static, moving, Peierls-Nabarro barrier
    driven              attractors and response curves of driven lattices
    chaos               Lyapunov exponents, alignment indices, frequencies, averages
    floquet             stability of periodic orbits
    orbits              any periodic orbit, and its symmetry
    newton              Newton's method
    continuation        pseudo-arclength continuation
Measurements and design
    fit                 parameters from measured traces, with errors
    Fit                 its result
    Traces              measured traces, from arrays and files
    information         what planned traces would determine; the best sensors
    Information         its result
    identify            sparse regression on lattice terms
    design              parameters that minimise an objective
    Design              its result
    smooth_peak         a differentiable maximum
Sweeps
    sweep               a function on a grid or list; saved, resumed, on many machines
    sweeps              `paired`, the points of a list
Theory
    theory              closed forms: envelopes, Toda, KdV, compactons, elliptic functions, shocks
    travelling          solitary waves, also of dimers and resonators; collisions, reflection
    shocks              dispersive shocks: strain steps, velocity shocks, pistons
    Resonator           a mass on a spring in every bead
    resonance           transmission of dimers over their mass ratio
Pictures and files
    plots               pictures of all results, with units
    explore             sliders and a picture that follows them, in a notebook
    Result              base class of all results: `to_xarray`, `save`, `in_units`
This process
    tune                XLA's flags
    clear               release compiled programs
"""

from .base import tuning as _tuning

_tuning.prepare_import()

from . import laws, solvers, strains, terms  # noqa: E402
from .base.tuning import clear, tune  # noqa: E402
from .base.units import Units  # noqa: E402
from .fit import Fit, Information, Traces, fit, information  # noqa: E402
from .fit.design import Design, design, smooth_peak  # noqa: E402
from .flow import (  # noqa: E402
    Arrival,
    CaputoRun,
    Derivative,
    Flow,
    Integral,
    Lowest,
    Peak,
    PeakTime,
    Record,
    Reversible,
    Run,
    RunWithMemory,
    caputo,
    derivative,
    simulate,
)
from .lattice import Lattice, State, vector_field  # noqa: E402
from .laws import (  # noqa: E402
    Hertz,
    Law,
    Linear,
    PlasticLaw,
    Polynomial,
    PowerLaw,
    Sine,
    Spline,
    Thornton,
    Toda,
    WaltonBraun,
    Yielding,
)
from .results import Result  # noqa: E402
from .solvers import (  # noqa: E402
    ABA864,
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
    BrilliantovContact,
    CaputoDamping,
    Damping,
    Dashpot,
    Drag,
    Drive,
    Harmonic,
    Langevin,
    LongRange,
    Modulated,
    OnSite,
    PlasticContact,
    Square,
    Term,
    ViscousContact,
    Wall,
)
from .work_precision import WorkPrecision, work_precision  # noqa: E402

__version__ = "0.2.0"
# Modules that are loaded when first used, so that import stays quick.
_LAZY = {
    name: f".{name}"
    for name in (
        "breathers",
        "continuation",
        "driven",
        "first_order",
        "floquet",
        "forced",
        "linear",
        "materials",
        "measures",
        "orbits",
        "plots",
        "resonance",
        "scenes",
        "shocks",
        "states",
        "sweeps",
        "theory",
        "travelling",
    )
} | {
    "chaos": ".orbits.chaos",
    "fractional": ".terms.fractional",
    "identify": ".fit.identify",
    "kinks": ".orbits.kinks",
    "newton": ".continuation.newton",
    "topology": ".linear.topology",
    "units": ".base.units",
}
_WITHIN = {
    "Equilibrium": ".continuation.equilibria",
    "Resonator": ".travelling",
    "equilibrium": ".continuation.equilibria",
    "explore": ".plots.explore",
    "sweep": ".sweeps",
}

__all__ = [
    "ABA864",
    "Arrival",
    "Bond",
    "Breaks",
    "BrilliantovContact",
    "CaputoDamping",
    "CaputoRun",
    "Damping",
    "Dashpot",
    "Derivative",
    "Design",
    "Drag",
    "Drive",
    "Equilibrium",
    "Fit",
    "Flow",
    "Harmonic",
    "Hertz",
    "Information",
    "Integral",
    "KahanLi8",
    "Langevin",
    "Lattice",
    "Law",
    "Linear",
    "LongRange",
    "Lowest",
    "Modulated",
    "OnSite",
    "Pairs",
    "Peak",
    "PeakTime",
    "PlasticContact",
    "PlasticLaw",
    "Polynomial",
    "PowerLaw",
    "RKN1210",
    "RKN86",
    "Record",
    "Resonator",
    "Result",
    "Reversible",
    "Run",
    "RunWithMemory",
    "SRKN11b",
    "SRKN14a",
    "SRKN6b",
    "Shift",
    "Sine",
    "SofroniouSpaletta10",
    "Spline",
    "Square",
    "State",
    "StrainMap",
    "Stretch",
    "Term",
    "Thornton",
    "Toda",
    "Traces",
    "Units",
    "VelocityVerlet",
    "ViscousContact",
    "Wall",
    "WaltonBraun",
    "WorkPrecision",
    "Yielding",
    "caputo",
    "clear",
    "derivative",
    "design",
    "equilibrium",
    "explore",
    "fit",
    "information",
    "laws",
    "simulate",
    "smooth_peak",
    "solvers",
    "strains",
    "sweep",
    "terms",
    "tune",
    "vector_field",
    "work_precision",
    *_LAZY,
]


def __getattr__(name):
    if name in _LAZY:
        import importlib

        return importlib.import_module(_LAZY[name], __name__)
    if name in _WITHIN:
        import importlib

        return getattr(importlib.import_module(_WITHIN[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
