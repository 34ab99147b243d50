"""What is measured of a dispersive shock."""

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..laws import Law
from ..results import Held, Result
from ..types import Number


class Shock(Result):
    r"""What `measure` returns, of a shock between a plateau and the chain `ahead` of it, at a time t.

    Places count bonds from that of the step; s = n/t.

    - `time` t [s]; `ahead`: strain of the chain ahead [m]; `sound` there [1/s].
    - `mean`: strain of the plateau, Hann-weighted over the bonds of `window` (2,), with `mean_error` [m].
    - `leading_speed`: of the leading crest [1/s]; `amplitude`: its height above `ahead` [m]; `leading_place`: n.
    - `trailing_speed`: s where the waves' amplitude comes to zero, by a parabola through s over amplitude [1/s].
    - `mean_error`, `leading_speed_error`, `amplitude_error`, `trailing_speed_error`: how well each is known at this t,
      by what half of the data, or another order, gives; for the trailing edge the length of a wave besides. What it
      becomes as t grows is further: by about 1/t, and of the crest by less and less. NaN where nothing tells an edge.
    - `s` (W,): n/t of windows inside the shock. In each the wave nearest to the strains, whatever the law: `means`,
      `amplitudes` = crest - trough [m], `wavelengths` [bonds], `omegas` [rad/s], `misfits`: what it leaves, over the
      amplitude. NaN where fewer than two crests pass.
    - `theory`: "toda" or "kdv", matched to the law at `ahead`, with the c [m/s] whose plateau has this mean, NaN where
      it has no such wave. To the left all speeds and places are below zero.
      `m` (W,): the modulation parameter whose wave is nearest to the strains, with `m_errors`; `speeds_of_m`: s that
      Whitham's theory has for it; `phases` (W,): Theta_0 with the theory's own m(s), in radians, which a velocity
      shock of Toda has in closed form, `gx.theory.toda.modulation(m, c).phase`; `theory_errors`: what then remains of
      the strains at most, over the jump `mean - ahead`.

    **Example:**

    >>> problem = gx.shocks.velocity_shock(gx.scenes.toda(200), 0.5)
    >>> shock = gx.shocks.measure(problem.run(step=0.1), points=3)
    >>> round(shock.mean, 2), shock.theory  # 2 ln 1.5 = 0.81
    (0.81, 'toda')
    >>> problem.kind, float(problem.c)
    ('velocity', 0.5)
    """

    held: ClassVar[dict[str, Held]] = {
        "time": Held("", "s"),
        "ahead": Held("", "m"),
        "sound": Held("", "1/s"),
        "mean": Held("", "m"),
        "mean_error": Held("", "m"),
        "window": Held("end", "1"),
        "leading_speed": Held("", "1/s"),
        "leading_speed_error": Held("", "1/s"),
        "leading_place": Held("", "1"),
        "amplitude": Held("", "m"),
        "amplitude_error": Held("", "m"),
        "trailing_speed": Held("", "1/s"),
        "trailing_speed_error": Held("", "1/s"),
        "c": Held("", "m/s"),
        "s": Held("s", "1/s"),
        "means": Held("s", "m"),
        "amplitudes": Held("s", "m"),
        "wavelengths": Held("s", "1"),
        "omegas": Held("s", "rad/s"),
        "misfits": Held("s", "1"),
        "m": Held("s", "1"),
        "m_errors": Held("s", "1"),
        "speeds_of_m": Held("s", "1/s"),
        "phases": Held("s", "rad"),
        "theory_errors": Held("s", "1"),
        "law": Held(None),
        "mass": Held("", "kg"),
    }
    time: float
    ahead: float
    sound: float
    mean: float
    mean_error: float
    window: Float[np.ndarray, "2"]
    leading_speed: float
    leading_speed_error: float
    leading_place: float
    amplitude: float
    amplitude_error: float
    trailing_speed: float
    trailing_speed_error: float
    c: float
    s: Float[np.ndarray, " s"]
    means: Float[np.ndarray, " s"]
    amplitudes: Float[np.ndarray, " s"]
    wavelengths: Float[np.ndarray, " s"]
    omegas: Float[np.ndarray, " s"]
    misfits: Float[np.ndarray, " s"]
    theory: str
    m: Float[np.ndarray, " s"]
    m_errors: Float[np.ndarray, " s"]
    speeds_of_m: Float[np.ndarray, " s"]
    phases: Float[np.ndarray, " s"]
    theory_errors: Float[np.ndarray, " s"]
    law: Law
    mass: Number
    outcome: str
