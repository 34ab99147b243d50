"""Linear theory of any lattice, traced from its terms: modes, dispersion, bands, sound.

The stiffness matrix is K = -d force/du at u = 0, by `jax.jvp` of the lattice's own force. Whatever reads the velocity
(damping) and whatever drives is left out: these are the undamped, free vibrations about equilibrium. `floquet_bands`
follows what changes periodically in time, stiffness and damping.
"""

from .bands import Bands, bands
from .cell import UnitCell, unit_cell
from .dispersion import Dispersion, dispersion
from .floquet_bands import FloquetBands, floquet_bands
from .modes import NormalModes, normal_modes
from .sound import sound_speed
from .transfer import LocalisationLength, localisation_length

__all__ = [
    "Bands", "Dispersion", "FloquetBands", "LocalisationLength", "NormalModes", "UnitCell", "bands", "dispersion",
    "floquet_bands", "localisation_length", "normal_modes", "sound_speed", "unit_cell",
]
