"""Measures of a state, `measure(lattice, y, t=0.0)`, and of recorded histories, `measure(ts, q)`.

Units follow the input: SI in, SI out. Space comes first and lanes last; in a history time comes
before both. Measures of a state work inside `jax.jit` and as quantities that `simulate` records;
they raise ValueError for a state of another shape than the lattice. `along` applies one to all
frames of a run.
"""

from .contacts import contact_force, contacts, overlap, sensor_force, strain
from .energies import energy, kinetic_energy, momentum, potential_energy, power, site_energy
from .fronts import Front, Peaks, arrival_times, front_speed, peak_times
from .histories import along, rms_velocity
from .localisation import energy_centre, participation, participation_number, second_moment
from .modal import effective_modes, modal_amplitudes, modal_energy, spectral_entropy
from .networks import ForceNetwork, force_network, slip_ratio
from .rings import FrontDecay, energy_radius, front_decay
from .spectra import Spectrogram, Spectrum, spectrogram, spectrum
from .transport import (
    Average,
    Correlation,
    GreenKubo,
    correlation,
    green_kubo,
    heat_current,
    time_average,
)
