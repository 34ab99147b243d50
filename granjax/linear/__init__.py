"""Linear theory of any lattice, derived from its terms: modes, dispersion, bands, sound.

The stiffness matrix is K = -d force/du at u = 0, by `jax.jvp`. Damping and drives are left out:
these are undamped, free vibrations about equilibrium. Gyroscopic forces, which turn velocities and
shift frequencies to first order, are included where waves are computed, and refused where the
stiffness alone is needed. `complex_bands` and `localisation_length` include damping,
`floquet_bands` also periodic changes in time.
"""

from .bands import Bands, bands
from .cell import UnitCell, unit_cell
from .dispersion import Dispersion, dispersion
from .evanescent import ComplexBands, complex_bands
from .flat import FlatBands, flat_bands
from .floquet_bands import FloquetBands, floquet_bands
from .modes import NormalModes, normal_modes
from .ribbon import RibbonBands, ribbon
from .sound import sound_speed
from .transfer import LocalisationLength, localisation_length
from .zone import DensityOfStates, PathBands, ZoneMap, density_of_states, path, zone_map

__all__ = [
    "Bands",
    "ComplexBands",
    "DensityOfStates",
    "Dispersion",
    "FlatBands",
    "FloquetBands",
    "LocalisationLength",
    "NormalModes",
    "PathBands",
    "RibbonBands",
    "UnitCell",
    "ZoneMap",
    "bands",
    "complex_bands",
    "density_of_states",
    "dispersion",
    "flat_bands",
    "floquet_bands",
    "localisation_length",
    "normal_modes",
    "path",
    "ribbon",
    "sound_speed",
    "unit_cell",
    "zone_map",
]
