"""How far closed forms are from the exact wave: the solitons of Korteweg and de Vries, and of Toda."""

import numpy as np

from ..checks import refuse
from ..lattice import Lattice
from ..laws import Law, taylor
from ..profiles import medium_of
from ..results import Result, array
from ..theory import kdv, toda
from ..types import Number, Numbers, Parameter, Scalar
from .solitary import solitary_wave

# places per contact at which strains are compared
FINENESS = 16


class ClosedForms(Result):
    """Errors of the solitons of KdV and of Toda, of the exact wave's speed, over several speeds.

    An error is max |y - phi|/max |phi| over all places.
    """

    speed: Numbers = array("The speeds of the waves.", "1/s", "speed")
    sound: Number = array("The speed of sound c_0.", "1/s")
    amplitude: Numbers = array("The peak strain of the exact wave.", "m", "speed")
    kdv_error: Numbers = array("The error of the soliton of KdV.", "1", "speed")
    toda_error: Numbers = array("The error of the soliton of Toda.", "1", "speed")
    exact_error: Numbers = array("The error to which the exact wave is known.", "1", "speed")

    @property
    def outcome(self) -> str:
        """The errors at the lowest and at the highest speed."""
        said = [
            f"at {abs(c) / self.sound:.6g} of sound KdV errs by {k:.2g} and Toda by {t:.2g} of the peak"
            for c, k, t in zip(self.speed, self.kdv_error, self.toda_error)
        ]
        return f"{said[0][0].upper()}{said[0][1:]}" + (f"; {said[-1]}." if len(said) > 1 else ".")


def closed_forms(law: Law | Lattice, speed: Parameter, *, mass: Scalar = 1.0) -> ClosedForms:
    """The exact solitary waves of a law beside the solitons of KdV and of Toda of the same speeds.

    Both have the law's K2 and K3 (`gx.laws.taylor`), by `theory.kdv` and `theory.toda.matched`, and both errors fall as
    c/c_0 - 1. Which of them is nearer follows from K4: Toda's is 2 K3^2/(3 K2), above that of a contact.

    **Arguments:** `law`, `mass`: as in `solitary_wave`; `speed`: (S,) or one, each above sound [contacts/s].
    **Returns:** `ClosedForms`. Typical: Hertz at 1 % above sound, 2.5 % and 2.9 %; Toda's own law, 1.3 % and none.
    **Raises** ValueError for a law without linear stiffness or without K3, and as `solitary_wave`.

    **Example:**

    >>> found = gx.travelling.closed_forms(gx.Toda(), [1.1])
    >>> round(float(found.kdv_error[0]), 3)  # Toda's own soliton is exact
    0.124
    """
    speeds = np.atleast_1d(np.asarray(speed, float))
    medium = medium_of(law, mass)
    K2, K3, _ = (float(x) for x in taylor(medium.law))
    if not K2 > 0 or K3 == 0:
        wanted = "one with K2 > 0 and with K3, which sets the width of both solitons"
        remedy = "Without sound there is neither; waves of a symmetric force are of the modified equation."
        refuse("law", wanted, f"K2 = {K2:g}, K3 = {K3:g}", remedy)
    constants = toda.matched(K2, K3)._asdict() | {"mass": medium.mass}
    sound = np.sqrt(K2 / np.asarray(medium.mass))
    rows = [_row(law, mass, c, K2, K3, constants) for c in speeds]
    return ClosedForms(speeds, sound, *map(np.array, zip(*rows)), **medium.origin)


def _row(law, mass, speed, K2, K3, constants):
    wave = solitary_wave(law, speed=speed, mass=mass)
    # where the wave is above rounding, finely
    x = np.linspace(0, np.max(wave.xi), int(FINENESS * np.max(wave.xi)) + 2)
    exact, peak = np.asarray(wave.strain(x)), abs(float(wave.amplitude))
    k = toda.wavenumber(speed=abs(speed), **constants)
    forms = (
        kdv.soliton(x, 0.0, K2, K3, speed=abs(speed), mass=constants["mass"]).strain,
        toda.soliton(x, 0.0, k, **constants).strain,
    )
    errors = [np.abs(np.asarray(form) - exact).max() / peak for form in forms]
    return wave.amplitude, *errors, float(wave.error) / peak
