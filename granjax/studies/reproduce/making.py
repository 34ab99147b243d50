"""Making figures: compute, compare, draw, write."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType

import equinox as eqx
import numpy as np

from ...checks import one_of, refuse
from ...entry import checked
from ...files import folder, netcdf, target, write
from ...results import Result
from .figure import Figure
from .registry import figure, figures

PICTURE, DATA = ".png", ".nc"


class Made(Result):
    """What became of one figure.

    - `label`; `number`, `expected`, `tolerance`; `passed`: whether they agree, `None` where the expected value does
      not hold for the parameters that were set. `seconds`: of the computation.
    - `parameters`: dict of the chosen parameters that were used; `picture`, `data`: paths, `None` where not written.
    - `failure`: a sentence where the simulation failed, and empty otherwise. `outcome`: all of it in a paragraph.

    **Example:**

    >>> made, = gx.reproduce.run("fig1.2", overrides={"reach": 3})
    >>> made.parameters
    {'speed': 1.0, 'reach': 3}
    """

    label: str = eqx.field(static=True)
    number: float
    expected: float
    tolerance: float
    passed: bool | None
    seconds: float
    parameters: dict[str, object]
    picture: Path | None = eqx.field(static=True)
    data: Path | None = eqx.field(static=True)
    failure: str = eqx.field(static=True)
    outcome: str = eqx.field(static=True)

    def __repr__(self) -> str:
        return self.outcome


@checked
def run(
    labels: str | Figure | Sequence[str | Figure] | None = None, out: str | Path | None = None, check: bool = False,
    plots: ModuleType | None = None, overrides: Mapping[str, object] | None = None,
) -> list[Made]:
    """Make figures: a picture `LABEL.png`, its data `LABEL.nc` and the number beside its expected value.

    **Arguments:**

    - `labels`: labels such as `"fig1.3"`, one or several; `None` for all.
    - `out`: folder for pictures and data, made where it is missing; `None` writes nothing.
    - `check`: compare the number with the expected value. A figure that fails does not stop the others.
    - `plots`: the module that draws, `granjax.plots`; needed where `out` is given.
    - `overrides`: dict from the name of a chosen parameter to its value, a number or its text; it holds for every
      figure asked for that has the parameter.

    **Returns:** a list of `Made`, one per label; after `check` all is well where none has `passed is False`.
    **Raises** ValueError for an unknown label (suggesting the nearest), a parameter that none of the
    figures has, or a folder that cannot be written.

    **Example:**

    >>> made, = gx.reproduce.run("fig1.2", check=True)
    >>> made.label, made.passed
    ('fig1.2', True)
    """
    return list(one_by_one(labels, out, check, plots, overrides))


@checked
def one_by_one(
    labels: str | Figure | Sequence[str | Figure] | None = None, out: str | Path | None = None, check: bool = False,
    plots: ModuleType | None = None, overrides: Mapping[str, object] | None = None,
) -> Iterator[Made]:
    """`run`, of which each `Made` is given out when it is there; what is wrong is refused at the call.

    **Example:**

    >>> for made in gx.reproduce.one_by_one("fig1.2", check=True):
    ...     print(made.label, made.passed)
    fig1.2 True
    """
    chosen = [figure(label) for label in _labels(labels)]
    overrides = dict(overrides or {})
    known = tuple(dict.fromkeys(name for f in chosen for name in f.chosen))
    for name in overrides:
        one_of("overrides", name, known)
    settings = [f.parameters({n: v for n, v in overrides.items() if n in f.chosen}) for f in chosen]
    if out is not None:
        if plots is None:
            refuse("plots", "the module that draws, such as granjax.plots, beside out=", "None")
        out = folder("out", out)
        for f in chosen:
            for ending in (PICTURE, DATA):
                target("out", out / f"{f.label}{ending}")
    return (_make(f, parameters, out, check, plots) for f, parameters in zip(chosen, settings))


def _labels(labels):
    if labels is None:
        return list(figures())
    if isinstance(labels, (str, Figure)):
        labels = (labels,)
    return [label.label if isinstance(label, Figure) else label for label in labels]


def _make(f, parameters, out, check, plots):
    start = time.perf_counter()
    try:
        data = f.compute(**parameters)
        value = float(f.number(data))
        failure = ""
    except RuntimeError as error:
        data, value, failure = None, math.nan, str(error)
    seconds = time.perf_counter() - start
    bound = all(parameters[name] == f.chosen[name].value for name in f.binding)
    passed = bool(abs(value - f.expected) <= f.tolerance) if bound or failure else None
    picture = path = None
    if out is not None and data is not None:
        _describe(f, parameters, data, value)
        path = write(out / f"{f.label}{DATA}", netcdf(data))
        with plots.style():
            canvas = plots.figure(*f.size)
            f.draw(plots, canvas, data)
        picture = write(out / f"{f.label}{PICTURE}", plots.drawn(canvas, PICTURE))
    outcome = _outcome(f, parameters, value, passed if check else None, bound, failure, picture, path)
    known = f.label, value, f.expected, f.tolerance, passed, seconds, parameters
    return Made(*known, picture, path, failure, outcome)


def _describe(f, parameters, data, value):
    """What the data file says of itself."""
    data.attrs |= {
        "figure": f.label, "title": f.title, "caption": f.caption, "quantity": f.quantity, "number": value,
        "expected": f.expected, "tolerance": f.tolerance, "source": f.source,
    }
    for name, parameter in parameters.items():
        data.attrs[f"chosen_{name}"] = parameter


def _outcome(f, parameters, value, passed, bound, failure, picture, path):
    lines = [f"{f.label}: {f.title}"]
    if failure:
        lines.append(f"  failed: {failure}")
    else:
        digits = max(0, 1 - int(np.floor(np.log10(f.tolerance))))
        holds = f"expected {f.expected:.{digits}f} +- {f.tolerance:g}, {f.source}"
        if not bound:
            holds += "; that value holds for the parameters chosen here, not for those set"
        verdict = {True: ": agrees", False: ": DISAGREES", None: ""}[passed]
        lines.append(f"  {f.quantity}: {value:.{digits}f} ({holds}){verdict}")
    if parameters:
        shown = (f"{n} = {v:g}" if isinstance(v, float) else f"{n} = {v}" for n, v in parameters.items())
        units = (f" {f.chosen[n].unit}" if f.chosen[n].unit else "" for n in parameters)
        lines.append("  chosen here: " + ", ".join(map("".join, zip(shown, units))))
    if picture or path:
        lines.append("  " + ", ".join(str(x) for x in (picture, path) if x))
    return "\n".join(lines)
