"""What to choose for an error that is asked for."""

import math
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import numpy as np

from ..checks import positive, refuse
from ..results import SI, Held, Result
from ..types import Scalar
from .ladder import DEFAULT, distance, in_turns, number, once, seconds_in_words

# an advised error lies between asked/NEAR and asked
NEAR = 3.0
TRIALS = 8
FASTEST = 3


class Advice(Result):
    """A method and its step or tolerance for an error; printed, it says so in words.

    - `asked`: the error that was asked for; `method`, `parameter`, `value`: what to use, `"default"` and NaN where
      that is no choice at all.
    - `error`, `seconds`, `evaluations`: what that gave when it was run (evaluations NaN where not known).
    - `default_error`, `default_seconds`: what no choice at all gives; NaN where that is not in the table.
    - `solver`: the solver, where it is one of `gx.simulate`'s.
    """

    _else: ClassVar[str | None] = SI
    held: ClassVar[dict[str, Held]] = {"seconds": Held(unit="s"), "default_seconds": Held(unit="s")}
    asked: float
    method: str = eqx.field(static=True)
    parameter: str = eqx.field(static=True)
    value: float
    error: float
    seconds: float
    evaluations: float
    default_error: float
    default_seconds: float
    solver: diffrax.AbstractSolver | None = None

    @property
    def keywords(self) -> dict[str, object]:
        """For `gx.simulate(lattice, state, t1, **advice.keywords)`; without the solver where it is not known.

        Empty where the default is the best choice.
        """
        if self.method == DEFAULT:
            return {}
        solver = {} if self.solver is None else {"solver": self.solver}
        return {**solver, self.parameter: self.value}

    @property
    def outcome(self) -> str:
        by_default = self.method == DEFAULT
        what = "the default" if by_default else f"{self.method}, {self.parameter} {self.value!r}"
        cost = f"{seconds_in_words(self.seconds)} (error {number(self.error)})"
        sentence = f"For {number(self.asked)}: {what}, {cost}"
        if not by_default and math.isfinite(self.default_error):
            seconds = seconds_in_words(self.default_seconds)
            sentence += f"; the default would give {number(self.default_error)} in {seconds}"
        return sentence + "."

    def __repr__(self) -> str:
        return self.outcome


def advise(table: Result, asked: Scalar) -> Advice:
    """`Advice` for an error, from a `WorkPrecision`; its docstring says how."""
    asked = float(positive("error", asked))
    known = [i for i in range(len(table.method)) if table.drawn[i] and table.method[i] != DEFAULT]
    if not known:
        refuse(
            "error",
            "a table with points to choose from",
            "one where nothing is drawn",
            "The notes say why.",
        )
    if asked < table.least_error:
        remedy = "The reference itself is no better."
        refuse(
            "error",
            f"at least {number(table.least_error)}, four times the floor",
            number(asked),
            remedy,
        )
    found = [_bracket(table, name, asked) for name in table.methods if name != DEFAULT]
    found = sorted((one for one in found if one is not None), key=lambda one: one.seconds)[:FASTEST]
    if not found:
        best = min(known, key=lambda i: table.error[i])
        remedy = f"The best point: {table.method[best]}, {table.parameter[best]} {number(table.value[best])}."
        refuse(
            "error",
            f"at least {number(table.error[best])}, the smallest in the table",
            number(asked),
            remedy,
        )
    default = [
        _point(table, i)
        for i, name in enumerate(table.method)
        if name == DEFAULT and table.drawn[i]
    ][:1]
    others = [_point(table, i) for i in known if table.error[i] <= asked]
    if table.ladders:
        # the clock drifts: what is compared is timed in the same turns
        others = sorted(others, key=lambda one: one.seconds)[:FASTEST]
        timed = _timed(
            table, [*(_approached(table, one, asked) for one in found), *default, *others]
        )
        found, default, others = (
            timed[: len(found)],
            timed[len(found) : -len(others)],
            timed[-len(others) :],
        )
    best = min(found, key=lambda one: one.seconds)
    # what luck has made good at this scene is better at this scene all the same
    while better := [one for one in default + others if _beats(one, best)]:
        best = min(better, key=lambda one: one.seconds)
    without_choice = (default[0].error, default[0].seconds) if default else (math.nan, math.nan)
    return Advice(
        asked,
        best.name,
        best.parameter,
        best.value,
        best.error,
        best.seconds,
        best.evaluations,
        *without_choice,
        best.ladder and best.ladder.solver,
    )


class _Choice(NamedTuple):
    """A method with a value whose error is at most what was asked; `coarse`: a value and its error above that."""

    name: str
    parameter: str
    value: float
    error: float
    seconds: float
    evaluations: float
    ladder: object
    coarse: tuple | None = None


def _beats(one, other):
    """Whether a choice is both better and faster; where a finer value of one method seems faster, the clock errs."""
    finer = one.name == other.name and one.value <= other.value
    return one.error <= other.error and one.seconds < other.seconds and not finer


def _bracket(table, name, asked):
    """The coarsest measured point from which on all are good enough, with its coarser neighbour, which is not."""
    own = [i for i in range(len(table.method)) if table.method[i] == name and table.drawn[i]]
    own.sort(key=lambda i: -table.value[i])
    bad = np.flatnonzero(table.error[own] > asked)
    if len(bad) == len(own):
        return None
    # a dip among larger errors is luck; where rounding spoils the finest point, the first dip has to do
    k = int(bad[-1]) + 1 if len(bad) else 0
    if k == len(own):
        k = int(np.argmax(table.error[own] <= asked))
    i, coarse, seconds = own[k], None, table.seconds[own[k]]
    if k and table.error[i] < asked / NEAR and table.ladders:
        j = own[k - 1]
        coarse = table.value[j], table.error[j]
        share = math.log(asked / table.error[i]) / math.log(table.error[j] / table.error[i])
        seconds *= (table.seconds[j] / seconds) ** share
    return _point(table, i)._replace(seconds=float(seconds), coarse=coarse)


def _point(table, i):
    """A measured point as a choice."""
    ladder = next((ladder for ladder in table.ladders if ladder.name == table.method[i]), None)
    numbers = (float(x[i]) for x in (table.value, table.error, table.seconds, table.evaluations))
    return _Choice(table.method[i], table.parameter[i], *numbers, ladder)


def _approached(table, choice, asked):
    """The choice with a value, of three digits, whose error a run has shown to lie within [asked/3, asked].

    Regula falsi in the logarithms, halved where it creeps. Where no run hits (a few steps of high order, of which one
    less is too few), the coarsest that is good enough.
    """
    if choice.coarse is None:
        return choice
    coarse, fine = choice.coarse, (choice.value, choice.error)
    aim = math.log(asked / math.sqrt(NEAR))
    for trial in range(TRIALS):
        share = (math.log(coarse[1]) - aim) / (math.log(coarse[1]) - math.log(max(fine[1], 1e-300)))
        share = 0.5 if trial % 3 == 2 else min(max(share, 0.1), 0.9)
        value = float(f"{coarse[0] * (fine[0] / coarse[0]) ** share:.2e}")
        called = once(choice.ladder.call, value)
        error = math.nan if called.note else distance(called.state, table.reference)
        if error <= asked:
            fine = value, error
            choice = choice._replace(value=value, error=error, evaluations=called.evaluations)
            if error >= asked / NEAR:
                break
        else:
            coarse = value, error if math.isfinite(error) else max(coarse[1], 1.0)
    return choice


def _timed(table, choices):
    """The choices with the median times of calls that take turns."""
    seconds, _ = in_turns([(one.ladder.call, one.value) for one in choices], table.repeats)
    return [one._replace(seconds=float(s)) for one, s in zip(choices, seconds)]
