"""The table that a measurement gives: points, methods, orders, and what it says in words."""

import json
import math
from collections.abc import Iterator
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ..results import SI, Held, Result
from ..types import Pytree, Scalar
from .advice import Advice, advise
from .ladder import Ladder, number, observed_order, seconds_in_words

# errors below this many floors are neither drawn nor used
DRAWN = 4.0
LARGEST_FLOOR = 1e-3
_COLUMNS = ("value", "error", "seconds", "fastest", "evaluations", "steps")
_WORDS = ("method", "parameter", "note")


class WorkPrecision(Result):
    """Error, time and force evaluations of many methods at many steps and tolerances. It prints itself.

    One entry a point (P,):

    - `method`, `parameter` (`"step"` or `"tolerance"`), `value`: what was run. The method `"default"` is
      `gx.simulate` without any choice; its value is NaN.
    - `error`: dimensionless, see `distance`. `seconds`: median wall time of a call [s], nothing compiled; `fastest`:
      the shortest. `evaluations`: of the force; `steps`; both NaN where not known.
    - `drawn`: whether the point says something; `note`: why not (refused, failed, below the floor).

    One entry a method (M,):

    - `methods`: names; `compile_seconds`: what the first call took beyond the second, NaN for the default, which
      shares a solver's; `limit`: longest stable step.

    And for all:

    - `floor`: uncertainty of the reference, the distance of two independent runs; nothing below four floors
      (`least_error`) is drawn. NaN where the reference was given without one.
    - `reference`, `reference_note`: what errors are measured against, and how it came about.
    - `repeats`: timed calls a point; `machine`: dict of processor, versions, date, commit.
    - `ladders`: what was measured, for `advice` to run more of it; empty after `from_json`.

    **Example:**

    >>> chain = gx.Lattice(1.0, gx.Bond(gx.Shift(1, "fixed"), gx.Linear()), sites=2)
    >>> state = gx.State(jnp.ones(2), jnp.ones(2))
    >>> table = gx.work_precision(chain, state, 2 * np.pi, gx.SRKN6b(), [0.1, 0.05], reference=state, repeats=1)
    >>> table.methods, table.value[:2]
    (('SRKN6b', 'default'), array([0.1 , 0.05]))
    """

    _else: ClassVar[str | None] = SI
    held: ClassVar[dict[str, Held]] = {
        name: Held("point") for name in (*_COLUMNS, *_WORDS, "drawn")
    } | {
        "seconds": Held("point", "s"),
        "fastest": Held("point", "s"),
        "methods": Held("method_name", "", "method_name"),
        "compile_seconds": Held("method_name", "s"),
        "limit": Held("method_name"),
        "order": Held("method_name"),
        "order_error": Held("method_name"),
        "reference_note": Held(None, "", "reference"),
    }
    method: tuple[str, ...] = eqx.field(static=True)
    parameter: tuple[str, ...] = eqx.field(static=True)
    value: Float[np.ndarray, " P"]
    error: Float[np.ndarray, " P"]
    seconds: Float[np.ndarray, " P"]
    fastest: Float[np.ndarray, " P"]
    evaluations: Float[np.ndarray, " P"]
    steps: Float[np.ndarray, " P"]
    drawn: Bool[np.ndarray, " P"]
    note: tuple[str, ...] = eqx.field(static=True)
    methods: tuple[str, ...] = eqx.field(static=True)
    compile_seconds: Float[np.ndarray, " M"]
    limit: Float[np.ndarray, " M"]
    floor: float
    repeats: int = eqx.field(static=True)
    reference_note: str = eqx.field(static=True)
    machine: dict[str, str | int | None] = eqx.field(static=True)
    ladders: tuple[Ladder, ...] = eqx.field(static=True, default=())
    reference: Pytree = None

    @property
    def outcome(self) -> str:
        return (
            f"{np.count_nonzero(self.drawn)} of {len(self.drawn)} points of {len(self.methods)} methods say something; "
            f"reference: {self.reference_note or 'given'}."
        )

    @property
    def least_error(self) -> float:
        """Four floors: the smallest error that is drawn; 0 where the floor is not known."""
        return DRAWN * self.floor if math.isfinite(self.floor) else 0.0

    @property
    def orders(self) -> dict[str, tuple[float, float]]:
        """Dict from method to (observed order, its standard error), NaN for tolerances or fewer than three points.

        Least squares in the logarithms between half the stability limit and the floor, see `observed_order`.
        """
        return {name: self._order(name, limit) for name, limit in zip(self.methods, self.limit)}

    def _order(self, name, limit):
        own = [
            i
            for i, method in enumerate(self.method)
            if method == name
            and self.drawn[i]
            and self.parameter[i] == "step"
            and self.value[i] <= limit / 2
        ]
        # the number of steps knows how far a step was shortened to fit
        steps = 1 / self.steps[own] if np.all(np.isfinite(self.steps[own])) else self.value[own]
        return observed_order(steps, self.error[own], self.floor)

    def advice(self, error: Scalar) -> Advice:
        """What to use for an error that you can live with, in the measure of `distance`.

        The fastest three methods are tried at values between their measured points until a run has shown an error
        between `error`/3 and `error`, and timed in turns. Where there is none (the longest stable step is better; one
        step fewer is worse), the coarsest value that is good enough; in a table that was read from a file, a measured
        point. What is promised (`.error`, `.seconds`) has been measured, always, and neither the default nor the
        fastest points of the table, timed in the same turns, are both faster and at least as good.

        **Returns:** `Advice`; `str` of it says so in words, `gx.simulate(..., **advice.keywords)` follows it.
        **Raises** ValueError for an error below four floors, or below all that was measured.
        """
        return advise(self, error)

    def __repr__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self):
        known = f"floor {number(self.floor)}" if math.isfinite(self.floor) else "floor not known"
        yield f"reference: {self.reference_note or 'given'}; {known}"
        for name, compiling in zip(self.methods, self.compile_seconds):
            order, uncertain = self.orders[name]
            observed = f", order {order:.2f} +- {uncertain:.2f}" if math.isfinite(order) else ""
            compiled = f", compiled in {seconds_in_words(compiling)}" if compiling > 1e-3 else ""
            yield f"{name}{observed}{compiled}"
            own = [i for i, method in enumerate(self.method) if method == name]
            yield from (self._line(i, before) for i, before in zip(own, [None, *own]))

    def _line(self, i, before):
        start = (
            f"  {self.parameter[i]:<10}{number(self.value[i]):<10}"
            if math.isfinite(self.value[i])
            else f"{'':22}"
        )
        if math.isfinite(self.error[i]):
            start += f"error {self.error[i]:<10.2e}"
        if not self.drawn[i]:
            known = before is not None and self.note[i] == self.note[before]
            return start + ("as above" if known else " ".join(self.note[i].split()))
        forces = f"{self.evaluations[i]:.0f} forces" if math.isfinite(self.evaluations[i]) else ""
        return f"{start}{seconds_in_words(self.seconds[i]):<11}{forces}"

    def _fields(self) -> Iterator[tuple[str, object]]:
        yield from (
            (name, x) for name, x in super()._fields() if name not in ("ladders", "reference")
        )
        orders = np.array([self.orders[name] for name in self.methods]).reshape(-1, 2)
        yield from zip(("order", "order_error"), orders.T)

    def to_dict(self) -> dict:
        """The table as plain numbers, strings, lists and dicts; what is not a number is `None`."""
        names = ("method", "parameter", *_COLUMNS, "drawn", "note")
        rows = zip(*(getattr(self, name) for name in names))
        methods = [
            {
                "name": name,
                "compile_seconds": compiling,
                "limit": limit,
                "order": order,
                "order_error": uncertain,
            }
            for (name, (order, uncertain)), compiling, limit in zip(
                self.orders.items(), self.compile_seconds, self.limit
            )
        ]
        points = [dict(zip(names, row)) for row in rows]
        return _plain(
            {
                "floor": self.floor,
                "reference": self.reference_note,
                "repeats": self.repeats,
                "machine": self.machine,
                "methods": methods,
                "points": points,
            }
        )

    def to_json(self, indent: int | None = None) -> str:
        """`to_dict` as one JSON object, a string."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)

    @classmethod
    def from_json(cls, text: str | bytes | dict) -> "WorkPrecision":
        """The table that `to_json` wrote (or its dict): for charts and for advice from measured points."""
        data = json.loads(text) if isinstance(text, str | bytes) else text
        points, methods = data["points"], data["methods"]
        return cls(
            **{name: _numbers(point[name] for point in points) for name in _COLUMNS},
            **{name: tuple(point[name] for point in points) for name in _WORDS},
            drawn=np.array([point["drawn"] for point in points], bool),
            methods=tuple(m["name"] for m in methods),
            compile_seconds=_numbers(m["compile_seconds"] for m in methods),
            limit=np.nan_to_num(_numbers(m["limit"] for m in methods), nan=np.inf),
            floor=float(_numbers([data["floor"]])[0]),
            reference_note=data["reference"],
            repeats=data["repeats"],
            machine=dict(data["machine"]),
        )


def _numbers(values):
    """Numbers as they are measured, NaN where there is `None`."""
    return np.array([math.nan if x is None else x for x in values], dtype=float)


def _plain(x):
    if isinstance(x, dict):
        return {name: _plain(value) for name, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain(value) for value in x]
    if isinstance(x, np.generic):
        x = x.item()
    return None if isinstance(x, float) and not math.isfinite(x) else x
