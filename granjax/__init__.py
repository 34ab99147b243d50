"""granjax: a differentiable simulator of nonlinear lattices on JAX.

`import granjax as gx` is enough. It switches float64 on unless the environment holds JAX_ENABLE_X64, and sets two XLA
flags that speed up its loops on the CPU unless it holds GRANJAX_TUNE=0; `gx.tune()` says what is in force.

    chain = gx.scenes.dimer(101, ratio=0.59)
    run = gx.simulate(chain, gx.states.impact(chain, velocity=1.0), 120.0, save_at=400)
    print(run)

What there is; `help(gx.simulate)` says more of each.

Scenes
    scenes              ready lattices: monomer, dimer, defects, disorder, FPUT, Toda, beads of materials in SI
    states              where they start: impact, rest, modes, packets, steps, random
    materials           steel, brass, PTFE ...; Hertz's contact coefficient from moduli and radii
    Units               sizes of a scene's units of mass, length and time in SI
Lattices
    Lattice             masses and terms, m a = sum of forces
    State               displacements and velocities, (u, v)
    vector_field        the equation of motion, for any diffrax solver
    Term                what a term of your own derives from
    Bond                a strain map and a law between sites
    OnSite              a force of each site's displacement
    Damping             a force -gamma m v
    Dashpot             a force of the rate of a bond
    ViscousContact      a dashpot that acts while a contact is closed
    Drag                a force of the velocity's square
    Langevin            a heat bath: damping and noise of a temperature
    LongRange           bonds to all neighbours of a chain, with weights of the distance
    Drive               a force of time on a site
    BrilliantovContact  viscoelastic spheres that do not pull
    CaputoDamping       a damping with the history of the velocity
    PlasticContact      contacts that yield, and remember their largest overlap
    Wall                a wall that yields, or moves
    Modulated           a term times a function of time
    Harmonic            a cosine of time, whose numbers can be swept
    Square              one that jumps between two values: layers in time
    Breaks              times at which a function of time jumps
    terms               the same, and what they are made of
Strain maps
    Shift               bonds to a neighbour, on chains and grids, between fields of a cell
    Pairs               bonds of any graph
    Stretch             bonds as distances in the plane or in space
    StrainMap           what a strain map of your own derives from
    strains             the same, and `Stencil`: sums over several sites and fields
Laws
    Hertz               spheres in contact, A d^{3/2}
    PowerLaw            contacts of any exponent, magnets
    Polynomial          Fermi, Pasta, Ulam and Tsingou
    Toda                exponential springs
    Linear              springs
    Sine                sine-Gordon
    Yielding            a contact in series with a spring
    WaltonBraun         a plastic contact, bilinear
    Thornton            a plastic contact of spheres
    PlasticLaw          what a plastic law of your own derives from
    Spline              a law of free shape that never falls
    Law                 what a law of your own derives from
    laws                the same, and their Taylor coefficients
Motion
    simulate            run a lattice in time
    Run                 what it returns
    caputo              a vector field with Caputo's derivative in time
    CaputoRun           what it returns
    RunWithMemory       what `simulate` returns where forces remember
    Peak                a record: the highest value between the steps
    PeakTime            a record: when it comes
    Lowest              the lowest
    Arrival             the time at which a quantity passes a threshold
    Integral            an integral over time
    Record              what a record of your own derives from
    Reversible          reverse mode by integrating backwards, without memory
    derivative          the derivative of a run, with its error
    Derivative          what it returns
    Flow                a map over a number of steps, with tangents
    first_order         DNLS, electrical lattices, the discrete p-Schroedinger equation; solitons, self-trapping
    fractional          kernel and symbol of the discrete fractional Laplacian
    measures            contact forces, energies, spectra, fronts, localisation of a state or a run
    equilibrium         where a lattice rests, and the loads that hold it
    Equilibrium         what it returns
    linear              modes, dispersion, bands, speed of sound, paths and strips of the plane, flat bands
    topology            Zak phases, winding, Chern and valley numbers, quadrupole
Solvers
    VelocityVerlet      order 2
    SRKN6b              order 4
    ABA864              order 4, of seven forces; higher for small perturbations
    SRKN11b             order 6
    SRKN14a             order 6, of 14 stages: orbits
    KahanLi8            order 8
    SofroniouSpaletta10 order 10
    RKN86               order 8, with a tolerance
    RKN1210             order 12, with a tolerance
    solvers             the same, and their stability
    work_precision      error against time of many solvers on a scene
    WorkPrecision       what it returns
Periodic orbits
    breathers           breathers and their families
    forced              orbits of driven lattices, and their branches
    kinks               what joins two wells of on-site forces: at rest, its Peierls-Nabarro barrier, moving
    driven              where driven lattices settle: attractors, response curves
    chaos               Lyapunov exponents, alignment indices, frequencies, averages
    floquet             stability of periodic orbits
    orbits              what these are made of: any orbit, its symmetry
    newton              Newton's method
    continuation        pseudo-arclength continuation
Measurements and design
    fit                 parameters from traces, with errors
    Fit                 what it returns
    Traces              what was measured, from arrays and files
    information         what planned traces would determine; the best sensors
    Information         what it returns
    identify            sparse regression on lattice terms
    design              parameters that minimise an objective
    Design              what it returns
    smooth_peak         a maximum that differentiates
Sweeps
    sweep               a function of parameters over a grid or a list; kept, resumed, on many machines
    sweeps              `paired`, the points of a list
Theory
    theory              closed forms: envelopes (nls), Toda, KdV, compactons, elliptic functions, shocks
    travelling          solitary waves, and waves of dimers and of beads with resonators; collisions, reflection
    shocks              dispersive shocks: strain steps, velocity shocks, pistons
    Resonator           a mass on a spring in every bead
    resonance           transmission of dimers over their mass ratio
Pictures and files
    plots               pictures of all of it, with units
    explore             sliders and a map that follows them, in a notebook
    Result              what every result is: `to_xarray`, `save`, `in_units`
This process
    tune                XLA's flags
    clear               let go of compiled programs
"""

from . import tuning as _tuning

_tuning.prepare_import()

from . import laws, solvers, strains, terms  # noqa: E402
from .design import Design, design, smooth_peak  # noqa: E402
from .fit import Fit, Information, Traces, fit, information  # noqa: E402
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
from .tuning import clear, tune  # noqa: E402
from .units import Units  # noqa: E402
from .work_precision import WorkPrecision, work_precision  # noqa: E402

__version__ = "0.2.0"
_LAZY = {
    name: f".{name}"
    for name in (
        "breathers",
        "chaos",
        "continuation",
        "driven",
        "first_order",
        "floquet",
        "forced",
        "fractional",
        "identify",
        "kinks",
        "linear",
        "materials",
        "measures",
        "newton",
        "orbits",
        "plots",
        "resonance",
        "scenes",
        "shocks",
        "states",
        "sweeps",
        "theory",
        "topology",
        "travelling",
    )
}
_WITHIN = {
    "Equilibrium": ".equilibria",
    "Resonator": ".travelling",
    "equilibrium": ".equilibria",
    "explore": ".notebook",
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
    """Submodules that are loaded when first asked for, so that import stays quick."""
    if name in _LAZY:
        import importlib

        return importlib.import_module(_LAZY[name], __name__)
    if name in _WITHIN:
        import importlib

        return getattr(importlib.import_module(_WITHIN[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
