"""A force law from traces: the law that a scene must have to move as it was measured to."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..checks import parameter, positive, refuse, whole
from ..fit import Fit, Traces, fit, prepared
from ..fit.determined import along
from ..fit.problem import Start
from ..fit.traces import checked_traces
from ..flow import Lowest, Peak, simulate
from ..lattice import Lattice
from ..laws import Law, Linear
from ..parameters import Bounds
from ..results import Held, Result, array
from ..types import Count, Parameter, Scalar
from .families import LawScene, law_scene, starting_law

# room around the strains of the linear run that a family is made for
WIDER = 1.2
# part of the way back to the start before it from which a stage begins
BACK = 1e-3


class ForceLaw(Result):
    """What `law` returns; outside of `strain_range` nothing is claimed."""

    law: Law = array("The identified `Law`.")
    fit: Fit = array("The `Fit`, with the numbers of the law and other parameters.")
    strain_range: tuple[float, float] = array(
        "The least and the largest strain of any bond that the law acts on, along the fitted run.",
        "m",
        "end",
    )
    scene: LawScene = array("The scene as a function of the parameters.")

    def force(
        self, e: Parameter
    ) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """(force, standard deviation) at strains e [N], by the delta method; NaN outside of `strain_range`."""
        e = np.asarray(parameter("e", e))
        with np.errstate(invalid="ignore"):
            inside = (e >= self.strain_range[0]) & (e <= self.strain_range[1])
        force, gradients = _with_gradients(
            self.scene,
            self.fit.problem.coordinates,
            self.fit.parameters,
            jnp.asarray(np.where(inside, e, 0.0)),
        )
        deviation = along(self.fit.directions, np.asarray(gradients) * np.asarray(self.fit.sizes))
        return np.where(inside, force, np.nan), np.where(inside, deviation, np.nan)

    def band(
        self, points: Count = 201, deviations: Scalar = 2.0
    ) -> tuple[Float[np.ndarray, " points"], ...]:
        """(strain, force, low, high), each (points,), over the strain range: the force and deviations to each side."""
        deviations = float(positive("deviations", deviations))
        e = np.linspace(*self.strain_range, whole("points", points, 2))
        force, deviation = self.force(e)
        return e, force, force - deviations * deviation, force + deviations * deviation

    def _fields(self) -> Iterator[tuple[str, object, Held]]:
        yield from super()._fields()
        for name, x in zip(("strain", "force", "low", "high"), self.band()):
            yield name, x, Held("strain", "m" if name == "strain" else "N")

    @property
    def outcome(self) -> str:
        """What became of it, in sentences."""
        low, high = self.strain_range
        _, force, bottom, top = self.band(deviations=1.0)
        worst = float(np.max(top - bottom)) / 2 / float(np.max(np.abs(force)))
        known = (
            f"to {100 * worst:.2g} % of its largest"
            if worst < 1
            else "not everywhere as well as its own size"
        )
        # a number of the law may stay open where its force does not
        said = dataclasses.replace(self.fit, directions=()).outcome
        return f"The force from e = {low:.3g} to {high:.3g} is known {known} (one standard deviation). {said}"


def law(
    scene: Callable[..., Lattice],
    family: str | Law,
    traces: Traces | Sequence[Traces],
    *,
    state: Start,
    stiffness: Scalar | None = None,
    reach: Sequence | None = None,
    others: dict[str, Parameter] | None = None,
    hold: Sequence[str] = (),
    bounds: Bounds = None,
    stages: Count = 4,
    **options: object,
) -> ForceLaw:
    r"""The force law of contacts, from traces of some sensors.

    `granjax.fit` over the numbers of a law: those of a formula, or of a law of free shape where no formula is known.

    **Arguments:**

    - `scene`: a function of the law that returns a `Lattice`,
      `lambda law: Lattice(1.0, (Bond(Shift(1, "fixed"), law), Damping(0.02)), sites=20)`; with `others` a function of
      the law and their dict.
    - `family`: `"power law"` (p, F0 and in place of A, whose unit holds p, the "force" A e_s^p at the largest strain
      e_s of `reach` move), `"polynomial"` (of degree 5), `"spline"` (monotone, 7 even knots) or `"network"` (one layer
      of 6 units that stay, whose weights move); or a `Law` where the search begins, all of whose numbers move: an
      exponent that is an array, not the scales of a `Network`, not the preload of a `Spline`.
    - `traces`, `state`: as in `fit`.
    - `stiffness`: rough linear stiffness [N/m], where a family is named. `reach`: (low, high), strains it is made for
      [m], low < 0 < high; `None` takes 1.2 times those of a linear run.
    - `others`: dict of further parameters with their starts, such as a damping. `hold`: names of numbers of the law
      that are known and stay, such as "precompression".
    - `bounds`: dict from names to (low, high); stiffnesses, precompressions and exponents keep their sign anyway.
    - `stages`: the record is taken up in parts that double, the first a share of 1/2^(stages - 1), so that no phase is
      lost by a whole turn on the way.
    - `options`: of `fit` (`t0`, `step`, `windows`, `starts`, `throw`, ...).

    **Returns:** `ForceLaw`. Traces of velocities see forces from equilibrium, not the preload: a static precompression
    is known only through the shape of a formula. Where strains stay small beside d0 a power law's A, p and F0 are not
    known apart, while its force is. Deviations hold where the family holds the law: what a spline, a polynomial or a
    network cannot bend to is not in them, but in chi^2.
    **Raises** ValueError for input that cannot be meant, among it a scene in which the law acts on nothing;
    RuntimeError where the fit fails. Typical: 20 beads, 4 to 8 sensors, strains up to the static overlap.
    Source: the delta method, e.g. Seber, Wild, Nonlinear Regression (1989), section 2.8.

    **Example:**

    >>> scene = lambda law: gx.Lattice(1.0, gx.Bond(gx.Shift(1, "free"), law), sites=2)
    >>> state, ts = gx.State(np.zeros(2), np.array([0.5, -0.5])), np.linspace(0.0, 5.0, 51)
    >>> traces = gx.Traces(ts, velocity=0.5 * np.cos(np.sqrt(2.0) * ts), sites=0, sigma=1e-3)
    >>> found = gx.identify.law(scene, gx.Linear(1.1), traces, state=state, stages=1, step=0.05)
    >>> round(float(found.law.stiffness), 4)
    1.0
    """
    others, strain = dict(others or {}), None
    if isinstance(family, str):
        if stiffness is None:
            refuse(
                "stiffness",
                "the linear stiffness, about",
                "None",
                "Sound speed c = a sqrt(K/m) gives it.",
            )
        stiffness = float(positive("stiffness", stiffness))
        reach = (
            _linear_reach(scene, stiffness, traces, state, others, options)
            if reach is None
            else reach
        )
        family, stays, strain = starting_law(family, stiffness, _checked_reach(reach))
        hold = (*hold, *stays)
    of_law, start, own = law_scene(scene, family, others, hold, strain)
    acting = _acting(of_law, start)
    traces, bounds = checked_traces(traces), {**own, **(bounds or {})}
    for share in 0.5 ** np.arange(whole("stages", stages, 1) - 1, 0, -1):
        early = [_until(trace, share) for trace in traces]
        ended = fit(
            of_law, start, early, state=state, bounds=bounds, **{**options, "throw": False}
        ).parameters
        # a number that the part does not see may have come to its bound, where no search can begin
        start = {name: x + BACK * (start[name] - x) for name, x in ended.items()}
    found = fit(of_law, start, traces, state=state, bounds=bounds, **options)
    return ForceLaw(
        of_law.law(found.parameters),
        found,
        _visited(acting, found.problem, found.parameters),
        of_law,
        **found.lattice.origin,
    )


def _until(trace, share):
    """The trace with nothing after a share of its record."""
    late = trace.times - trace.times[0] > share * (trace.times[-1] - trace.times[0])
    return eqx.tree_at(
        lambda trace: trace.data, trace, jnp.where(late[:, None], jnp.nan, trace.data)
    )


def _linear_reach(scene, stiffness, traces, state, others, options):
    of_law, start, _ = law_scene(scene, Linear(stiffness), others, ())
    acting = _acting(of_law, start)
    problem = prepared(of_law, start, traces, state=state, **options)
    low, high = _visited(acting, problem, problem.coordinates.start)
    return WIDER * low, WIDER * high


def _checked_reach(reach):
    reach = np.asarray(parameter("reach", reach))
    if reach.shape != (2,) or not reach[0] < 0 < reach[1]:
        refuse(
            "reach", "(low, high) with low < 0 < high", repr(reach.tolist()), "0 is equilibrium."
        )
    return tuple(map(float, reach))


def _acting(of_law, parameters):
    """The terms of the scene that the law acts in, by index."""
    marked = of_law.law(parameters)
    lattice = of_law.lattice(marked, parameters)
    is_law = lambda part: part is marked
    holds = lambda term: any(map(is_law, jax.tree.leaves(term, is_leaf=is_law)))
    acting = tuple(i for i, term in enumerate(lattice.terms) if holds(term))
    if not acting:
        refuse(
            "scene",
            "a scene in which the law acts on bonds or sites",
            f"{lattice}",
            "Use the law as it comes, Bond(Shift(1, 'fixed'), law).",
        )
    return acting


def _visited(acting, problem, parameters):
    """Least and largest strain of what the law acts on, up to the last sample."""
    lattice = problem.lattice(parameters)
    state, last = problem.state(parameters, lattice), problem.times(parameters).max()
    strains = _Strains(acting)
    run = simulate(
        lattice,
        state,
        last,
        t0=problem.t0,
        solver=problem.solver,
        step=problem.step,
        throw=False,
        record={"least": Lowest(strains), "most": Peak(strains)},
    )
    return float(run.recorded["least"].min()), float(run.recorded["most"].max())


class _Strains(eqx.Module):
    """The compressions of some terms of a lattice, one array."""

    acting: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, t, y, lattice):
        found = [
            c.compression.ravel()
            for i in self.acting
            for c in lattice.terms[i].compressions(t, y.u)
        ]
        return jnp.concatenate(found)


@eqx.filter_jit
def _with_gradients(scene, coordinates, parameters, e):
    """The force at strains e and its derivatives with respect to every parameter (strains, P)."""
    force = lambda flat: scene.law(coordinates.unflat(flat)).force(e)
    return scene.law(parameters).force(e), jax.jacfwd(force)(coordinates.flat(parameters))
