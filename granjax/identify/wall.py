"""Elastic modulus of a wall, from a wave that a granular chain sends against it: the actuator-sensor for bone."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import one_of, positive, refuse, whole, within
from ..fit import Fit, Traces, fit, linearised, prepared
from ..fit.problem import Start
from ..lattice import Lattice
from ..laws import Hertz
from ..materials import Material, hertz_coefficient
from ..results import SI, Result, array
from ..terms import Wall
from ..terms.chain import walls
from ..types import Count, Numbers, Parameter, Scalar

NAME = "modulus"


class WallModulus(Result):
    """What `wall_modulus` returns."""

    _else: ClassVar[str | None] = SI
    modulus: float = array("Young's modulus E of the wall at the given Poisson ratio.", "Pa")
    deviation: float = array("The standard deviation of the modulus.", "Pa")
    plane_modulus: float = array(
        "E/(1 - nu^2), which the data determine without a Poisson ratio of the wall.", "Pa"
    )
    reduced_modulus: float = array(
        "E* of the contact, which depends on the bead's material too.", "Pa"
    )
    stiffness: float = array(
        "The stiffness A of the contact, which depends on the bead's material too.", "N/m^{3/2}"
    )
    relative: Float[np.ndarray, "3"] = array(
        "Relative standard deviations of `plane_modulus`, `reduced_modulus` and `stiffness`.",
        "1",
        "quantity",
    )
    scanned: Float[np.ndarray, " scanned"] = array("The moduli that were tried first.", "Pa")
    chi_square: Float[np.ndarray, " scanned"] = array(
        "How far each scanned modulus is from the data.", "1"
    )
    fit: Fit = array("The `Fit`, with other parameters that were fitted.")

    @property
    def outcome(self) -> str:
        """What became of it, in sentences."""
        said = f"E = {self.modulus:.4g} +- {self.deviation:.2g} Pa."
        if _least(self.chi_square) in (0, len(self.scanned) - 1):
            said += " The nearest of the scanned moduli is at their end: give another start, or a larger factor."
        return f"{said} {self.fit.outcome}"


class WallScene(eqx.Module):
    """A lattice with a wall at its end as a function of a dict of parameters: equal ones compile once."""

    free: object
    material: str | Material
    radius: Scalar
    poisson: Scalar
    precompression: Scalar
    side: str = eqx.field(static=True)
    others: tuple[str, ...] = eqx.field(static=True)

    def stiffness(self, modulus: Scalar) -> Numbers:
        """A of the contact with the wall."""
        return hertz_coefficient(
            self.material, self.radius, Material("wall", modulus, self.poisson, 1.0), jnp.inf
        )

    def __call__(self, parameters: dict[str, Numbers]) -> Lattice:
        others = {name: parameters[name] for name in self.others}
        free = self.free(others) if callable(self.free) else self.free
        if any(self.side in walls(term) for term in free.terms):
            refuse(
                "lattice",
                f"no contact with a wall at its {self.side} end",
                "one",
                'Make it with boundary="free".',
            )
        wall = Wall(Hertz(self.stiffness(parameters[NAME]), self.precompression), self.side)
        walled = eqx.tree_at(lambda x: x.terms, free, (*free.terms, wall))
        walled.check_terms()
        return walled


def wall_modulus(
    lattice: Lattice | Callable[[Any], Lattice],
    traces: Traces | Sequence[Traces],
    *,
    state: Start,
    material: str | Material,
    radius: Scalar,
    start: Scalar,
    poisson: Scalar = 0.3,
    precompression: Scalar = 0.0,
    side: str = "right",
    others: dict[str, Parameter] | None = None,
    factor: Scalar = 10.0,
    scan: Count = 13,
    **options: object,
) -> WallModulus:
    r"""Young's modulus of the wall at the end of a chain, from one trace of the wave that it reflects.

    The last bead, a sphere of radius R, touches the wall, a half-space: F = A d^{3/2}, A = (4/3) E* sqrt(R),
    1/E* = (1 - nu_b^2)/E_b + (1 - nu^2)/E. The softer the wall, the later and the flatter the reflected wave, and
    below a modulus that depends on the chain a second one follows. The trace is compared at moduli from start/factor
    to start*factor, and the nearest is where `granjax.fit` begins, with log E as coordinate, so that it does not end
    at a modulus whose pulse meets another one of the trace.

    **Arguments:**

    - `lattice`: a chain in SI without a contact at that end, `gx.scenes.beads(..., boundary="free")`; or a function
      of the dict `others` that returns one.
    - `traces`, `state`: as in `fit`: one `Traces` of the velocity of a bead or the force of a contact. `state` may be a
      function (parameters, lattice).
    - `material`, `radius`: of the bead at the wall, a name or a `Material`, and R [m].
    - `start` [Pa]: a guess of E; `factor` > 1, `scan`: how far and how finely it is scanned.
    - `poisson`: nu of the wall, taken as known. An error of 0.1 at 0.3 moves E by 5 to 8 %.
    - `precompression`: static force F0 of the chain [N]. `side`: of the wall.
    - `others`: dict of further parameters to fit, with their starts, such as the velocity of impact.
    - `options`: of `fit` (`bounds` of the others, `step`, `throw`, ...).

    **Returns:** `WallModulus`. **Raises** ValueError for input that cannot be meant, RuntimeError where the fit fails.
    A wall much stiffer than the beads is known badly: dA/A = s dE/E with s = E*(1 - nu^2)/E. Typical: chains of 20
    steel beads of 9.53 mm radius, bone 2 ... 20 GPa.
    Source: Yang, Silvestro, Khatri, De Nardo, Daraio, Phys. Rev. E 83, 046606 (2011).

    **Example:**

    >>> walled = gx.scenes.beads("steel 316", 9.53e-3, cells=3, wall=gx.materials.Material("bone", 10e9, 0.3, 1900.0))
    >>> run = gx.simulate(walled, gx.states.impact(walled, 0.4), 2e-4, step=1e-6, save_at=41)
    >>> traces = gx.Traces(run.ts, velocity=run.vs[:, 1], sites=1)
    >>> chain = gx.scenes.beads("steel 316", 9.53e-3, cells=3, boundary="free")
    >>> known = {"material": "steel 316", "radius": 9.53e-3, "start": 15e9, "scan": 3, "step": 1e-6}
    >>> found = gx.identify.wall_modulus(chain, traces, state=gx.states.impact(chain, 0.4), **known)
    >>> round(found.modulus / 1e9, 3)
    10.0
    """
    others = dict(others or {})
    if NAME in others:
        refuse("others", f"parameters beside {NAME!r}", f"{NAME!r}", "Its start is start=.")
    start = float(
        positive("start", start, "It is a guess of the wall's Young's modulus in pascal.")
    )
    factor = float(within("factor", factor, 1, np.inf, open_low=True, open_high=True))
    poisson = float(
        within(
            "poisson", poisson, -1, 0.5, open_low=True, remedy="Poisson's ratio is 0.3 for bone."
        )
    )
    one_of("side", side, ("left", "right"))
    # arrays, whose values compile nothing anew; a wall without a load has a law without one
    known = [jnp.asarray(x, float) if np.any(x) else x for x in (radius, poisson, precompression)]
    scene = WallScene(lattice, material, *known, side, tuple(others))
    bounds = {**(options.pop("bounds", None) or {}), NAME: (0.0, None)}
    scan = whole("scan", scan, 3)
    ladder = start * np.geomspace(1 / factor, factor, scan)
    # the stiffest wall sets the step
    stiffest = {**others, NAME: ladder[-1]}
    problem = prepared(scene, stiffest, traces, state=state, bounds=bounds, **options)
    at = np.zeros((len(ladder), problem.coordinates.size))
    at[:, -1] = np.log(ladder / ladder[-1])
    chi_square = np.array(
        [np.sum(np.asarray(linearised(problem, jnp.asarray(x))[0]) ** 2) for x in at]
    )
    found = fit(
        scene,
        {**others, NAME: ladder[_least(chi_square)]},
        traces,
        state=state,
        bounds=bounds,
        **options,
    )
    modulus, deviation = float(found.parameters[NAME]), float(found.deviations[NAME])
    A, slope = jax.value_and_grad(scene.stiffness)(jnp.asarray(modulus))
    relative, share = deviation / modulus, float(slope) * modulus / float(A)
    return WallModulus(
        modulus,
        deviation,
        modulus / (1 - poisson**2),
        float(0.75 * A / np.sqrt(radius)),
        float(A),
        relative * np.array([1.0, share, share]),
        ladder,
        chi_square,
        found,
    )


def _least(chi_square):
    return int(np.argmin(np.where(np.isfinite(chi_square), chi_square, np.inf)))
