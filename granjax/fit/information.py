"""`information`: how well a planned measurement determines parameters, and the best sensors."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractSolver
from jaxtyping import Float

from ..base.checks import refuse, whole
from ..base.programs import compiled
from ..base.types import AnyArray, Count, Number, Numbers, Parameter, Scalar, Scene
from ..results import Result, array, note
from .problem import Problem, Start, prepared
from .traces import Traces

# A direction is not determined if its eigenvalue is below this share of the largest, in units of
# what is seen of each parameter alone.
BLIND = 1e-12


class Information(Result):
    """The Fisher information of each sensor about the parameters.

    Independent sensors add their information.
    """

    matrix: Float[AnyArray, "S P P"] = array(
        "The Fisher information of each sensor, about absolute changes of parameters.",
        axes="sensor parameter parameter_",
    )
    values: Float[AnyArray, " P"] = array("The parameters.", axes="parameter")
    names: tuple[str, ...] = array(
        "The names of the parameters.", axes="parameter", name="parameter", static=True
    )
    sensors: tuple[str, ...] = array("The sensors.", axes="sensor", name="sensor", static=True)
    places: tuple[int, ...] = note("The indices of the sensors among all candidates.", static=True)

    @property
    def log_det(self) -> Number:
        """log det of the information of all sensors about relative changes of the parameters.

        (Absolute changes for zero ones.) A D-optimal experiment maximises it, as `gx.design` can.
        """
        size = jnp.where(self.values != 0, self.values, 1)
        return jnp.linalg.slogdet(self.matrix.sum(0) * size[:, None] * size)[1]

    @property
    def covariance(self) -> Float[AnyArray, "P P"]:
        """The Cramer-Rao bound on the covariance of unbiased estimates, as in `gx.fit`."""
        alone = self._alone
        return jnp.linalg.inv(self._relative_to_alone.sum(0)) * alone[:, None] * alone

    @property
    def _alone(self):
        # The change of each parameter alone that the sensors see as one standard deviation.
        seen = jnp.diag(self.matrix.sum(0))
        return jnp.where(seen > 0, 1 / jnp.sqrt(jnp.where(seen > 0, seen, 1)), 1)

    @property
    def _relative_to_alone(self):
        return self.matrix * self._alone[:, None] * self._alone

    @property
    def deviations(self) -> dict[str, Number]:
        """The least standard deviation of each parameter, by name; infinite if not `determined`."""
        deviations = np.full(len(self.names), np.inf)
        if self.determined:
            deviations = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.names, deviations))

    @property
    def determined(self) -> bool:
        """Whether the sensors determine all parameters."""
        levels = np.linalg.eigvalsh(self._relative_to_alone.sum(0))
        return bool(levels[0] > BLIND * levels[-1])

    @property
    def outcome(self) -> str:
        """A sentence on how well the sensors determine the parameters."""
        many = len(self.sensors) > 1
        count = f"{len(self.sensors)} sensor{'s' * many}"
        if not self.determined:
            return (
                f"{count} {'do' if many else 'does'} not determine all of {', '.join(self.names)}."
            )
        shares = [
            f"{name} = {value:.4g} +- {deviation:.1g}"
            for value, (name, deviation) in zip(self.values, self.deviations.items())
        ]
        return f"{count} would determine {', '.join(shares)}."

    def best(self, count: Count) -> "Information":
        """Choose a number of sensors with the largest `log_det` (D-optimal).

        Sensors are added one by one, then exchanged while that improves. With few candidates this
        mostly finds the optimum.

        **Arguments:** `count`: how many.
        **Returns:** the `Information` of these alone, in the order of `sensors`.
        **Raises** ValueError for more than there are.
        Source: Fedorov, Theory of Optimal Experiments (1972).
        """
        every = len(self.sensors)
        if whole("count", count, 1) > every:
            refuse("count", f"at most {every}, the sensors there are", f"{count}")
        each = np.asarray(self._relative_to_alone)
        # The floor keeps the determinant positive while too few sensors are chosen to determine
        # all parameters. The choice then prefers those that see most of what all see together.
        floor = BLIND * np.eye(len(self.names))
        worth = lambda chosen: np.linalg.slogdet(each[chosen].sum(0) + floor)[1]

        def joined(others):
            left = [i for i in range(every) if i not in others]
            return [*others, max(left, key=lambda i: worth([*others, i]))]

        chosen: list[int] = []
        for _ in range(count):
            chosen = joined(chosen)
        better = True
        while better:
            better = False
            for gone in tuple(chosen):
                other = joined([i for i in chosen if i != gone])
                if worth(other) > worth(chosen) + 1e-12 * abs(worth(chosen)):
                    chosen = other
                    better = True
        chosen = sorted(chosen)
        pick = lambda x: tuple(x[i] for i in chosen)
        return dataclasses.replace(
            self,
            matrix=self.matrix[np.array(chosen)],
            sensors=pick(self.sensors),
            places=pick(self.places),
        )


def information(
    scene: Scene,
    parameters: dict[str, Parameter],
    traces: Traces | list[Traces],
    *,
    state: Start,
    t0: Scalar = 0.0,
    step: Scalar | None = None,
    solver: AbstractSolver | None = None,
) -> Information:
    r"""Compute the Fisher information of planned traces about the parameters of a scene.

    F = sum over samples of (d signal/d theta)(d signal/d theta)^T/sigma^2, one matrix for each
    sensor. The inverse of their sum is the covariance that `gx.fit` reports if the scene is right.

    **Arguments:**

    - `scene`, `state`, `t0`, `step`, `solver`: as in `gx.fit`.
    - `parameters`: the values at which to evaluate the information.
    - `traces`: `gx.Traces` of all candidate sensors, with times and `sigma`. Data may be zeros.

    **Returns:** `Information`; `.best(3)` is the D-optimal choice of three sensors. With `step` it
    is differentiable with respect to quantities in the scene, such as a drive frequency.
    **Raises** ValueError as `gx.fit` does, and for traces without `sigma`.

    **Example:**

    >>> scene = lambda p: gx.scenes.monomer(6, stiffness=p["stiffness"], precompression=p["load"])
    >>> times = np.linspace(0.0, 10.0, 51)
    >>> everywhere = gx.Traces(times, velocity=np.zeros((51, 6)), sites=range(6), sigma=1e-3)
    >>> struck = lambda p, chain: gx.states.impact(chain, velocity=0.1)
    >>> found = gx.information(scene, {"stiffness": 1.0, "load": 0.5}, everywhere, state=struck)
    >>> found.best(2).places
    (3, 5)
    """
    problem = prepared(scene, parameters, traces, state=state, t0=t0, step=step, solver=solver)
    if any(trace.sigma is None for trace in problem.traces):
        refuse("sigma", "the noise of every sensor", "None", "Information is relative to it.")
    values = problem.coordinates.flat(problem.coordinates.start)
    names = tuple(problem.coordinates.names)
    sensors = tuple(name for trace in problem.traces for name in trace.sensors)
    matrix = _matrices(problem, jnp.asarray(values, problem.dtype))
    return Information(matrix, values, names, sensors, tuple(range(len(sensors))))


@compiled
def _matrices(problem: Problem, values: Numbers) -> Numbers:
    def signals(values):
        # adjoint=None supports both modes, so that the information can be differentiated.
        return problem.signals(problem.coordinates.unflat(values), adjoint=None)[0]

    slopes = jax.jacfwd(signals)(values)
    return jnp.concatenate(
        [
            jnp.einsum("ts,tsp,tsq->spq", trace.weights**2, slope, slope)
            for trace, slope in zip(problem.traces, slopes)
        ]
    )
