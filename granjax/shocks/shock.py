"""`Shock`: the measured numbers of a dispersive shock."""

import equinox as eqx
import numpy as np

from ..base.types import Number, Numbers
from ..laws import Law
from ..results import Result, array, note

# The misfit of a theory, over the jump, above which the outcome mentions it.
MISSES = 0.3


class Shock(Result):
    r"""The result of `measure`: a shock between a plateau and the chain `ahead` of it, at a time t.

    Places count bonds from the step; s = n/t. Errors are those at this t, from half of the data or
    another order; that of the trailing edge includes the length of a wave. The limits of large t
    differ by about 1/t, and by ever less for the crest. An edge that cannot be determined is NaN.
    In each window inside the shock the wave nearest to the strains is fitted, for any law; NaN
    where fewer than two crests pass. To the left all speeds and places are negative.
    """

    time: float = array("The time t.", "s")
    ahead: float = array("The strain of the chain ahead.", "m")
    sound: float = array("The speed of sound ahead.", "1/s")
    mean: float = array("The strain of the plateau, Hann-weighted over the bonds of `window`.", "m")
    mean_error: float = array("The error of the mean.", "m")
    window: Numbers = array("The first and the last bond of the plateau.", "1", "end")
    leading_speed: float = array("The speed of the leading crest.", "1/s")
    leading_speed_error: float = array("The error of the leading speed.", "1/s")
    leading_place: float = array("The place n of the leading crest.", "1")
    amplitude: float = array("The distance of the leading crest from `ahead`.", "m")
    amplitude_error: float = array("The error of the amplitude.", "m")
    trailing_speed: float = array(
        "The speed s at which the waves' amplitude vanishes, by a parabola of s over amplitude.",
        "1/s",
    )
    trailing_speed_error: float = array("The error of the trailing speed.", "1/s")
    c: float = array("The velocity c whose plateau has this mean, by `theory`.", "m/s")
    s: Numbers = array("The speed n/t of windows inside the shock.", "1/s", "s")
    means: Numbers = array("The mean strain in each window.", "m", "s")
    amplitudes: Numbers = array("Crest less trough in each window.", "m", "s")
    wavelengths: Numbers = array("The wavelength in each window, in bonds.", "1", "s")
    omegas: Numbers = array("The frequency in each window.", "rad/s", "s")
    misfits: Numbers = array(
        "The largest residual of the fitted wave, over the amplitude.", "1", "s"
    )
    theory: str = array('The theory, "toda" or "kdv", matched to the law at `ahead`.', static=True)
    m: Numbers = array(
        "The modulation parameter of the theory's wave nearest to the strains.", "1", "s"
    )
    m_errors: Numbers = array("The error of m.", "1", "s")
    speeds_of_m: Numbers = array("The speed s of m by Whitham's theory.", "1/s", "s")
    phases: Numbers = array(
        "Theta_0 with the theory's own m(s); for a velocity shock of Toda that of "
        "`gx.theory.toda.modulation(m, c).phase`.",
        "rad",
        "s",
    )
    theory_errors: Numbers = array(
        "The largest residual of the theory's strains, over the jump `mean - ahead`.", "1", "s"
    )
    law: Law = note("The law of the contacts.")
    mass: Number = array("The mass of the beads.", "kg")
    # The reason why the theory has no waves to compare with.
    _not_compared: str = eqx.field(static=True, default="")

    @property
    def outcome(self) -> str:
        """The kind of shock, the windows with waves, and the misfit of the theory."""
        found = np.isfinite(self.amplitudes)
        told = [
            f"A shock of {'compression' if self.mean > self.ahead else 'rarefaction'}; waves found in "
            f"{found.sum()} of {found.size} windows."
        ]
        if not np.isfinite(self.trailing_speed):
            told.append(
                "No trailing edge: the waves reach as far as the step, or tell too little of it."
            )
        misses = np.nanmax(self.theory_errors, initial=0)
        if misses > MISSES:
            told.append(f"The theory's waves miss the strains by up to {misses:.2g} of the jump.")
        return " ".join([*told, self._not_compared]).strip()
