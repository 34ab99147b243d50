"""A sweep that stands in a TOML file: what the scene is, what varies, what is recorded, where it goes."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import numpy as np

from ... import solvers
from ...checks import described, refuse
from ...entry import checked
from ...flow import simulate
from ...lattice import Lattice, State
from ...materials import Material
from ...units import SI
from ..points import Points, paired, points_of, random
from .keys import REQUIRED, Table
from .records import Recorded, record_of
from .scene import (
    SCENES,
    STARTS,
    Call,
    Target,
    call_of,
    kinds,
    needed,
    plain,
    said_of,
    target_of,
    targets,
    unit_of,
    values_kind,
)
from .text import tables

SOLVERS = ("VelocityVerlet", "SRKN6b", "SRKN11b", "SRKN14a", "KahanLi8", "SofroniouSpaletta10", "RKN86", "RKN1210")
MOST_VALUES, MOST_LANES, MOST_SEED = 1_000_000, 10_000_000, 2**32 - 1
ENDINGS = {"store": (".nc",), "picture": (".png", ".svg", ".pdf"), "table": (".csv", ".mat", ".npz")}
TABLES = ("title", "materials", "scene", "start", "vary", "design", "run", "record", "result")
UNTIL = Target("run", "until", None)
# values of one parameter that are looked at before anything runs, where they are words or whole numbers
LOOKED_AT = 64


class Lane:
    """The function of a file's sweep: of the parameters by their names, the records of one lane as a dict.

    Equal files give equal functions, so that nothing compiles twice.
    """

    def __init__(
        self, scene: Call, start: Call | None, said: str, own: dict[str, tuple], targets: dict[str, Target],
        run: dict[str, Any], records: dict[str, Recorded],
    ):
        self.scene, self.start, self.said, self.own = scene, start, said, own
        self.targets, self.run, self.records = targets, run, records
        self.told = repr((scene, start, said, own, targets, run, records))
        self.__name__ = self.__qualname__ = "lane"

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Lane) and self.told == other.told

    def __hash__(self) -> int:
        return hash(self.told)

    @property
    def reads(self) -> dict[str, str]:
        """What the file says of a lane, by its places: what tells this function from that of another file."""
        found = {f"[{call.table}] kind": call.kind for call in (self.scene, self.start) if call is not None}
        for call in filter(None, (self.scene, self.start)):
            found |= {f"[{call.table}] {name}": repr(x) for name, x in call.arguments.items()}
        found |= {f"[materials.{name}]": repr(numbers) for name, numbers in self.own.items()}
        found |= {f"[run] {name}": repr(x) for name, x in self.run.items()}
        return found | {f"[record.{name}]": repr(r) for name, r in self.records.items()} | {"units": self.said}

    def __call__(self, **values: Any) -> dict[str, jax.Array]:
        placed = {self.targets[name]: value for name, value in values.items()}
        found = self._found(placed, self.records)
        for relative in dict.fromkeys(r.relative_to for r in self.records.values() if r.relative_to):
            those = {name: r for name, r in self.records.items() if r.relative_to == relative}
            reference = self._found({**placed, **dict(relative)}, those)
            found |= {name: found[name] / reference[name] for name in those}
        return found

    def _found(self, values, records):
        lattice = self.lattice(values)
        run = None
        if any(r.runs for r in records.values()):
            followed = {name: r.record for name, r in records.items() if r.record is not None}
            run = simulate(lattice, self.state(lattice, values), self.until(lattice, values), record=followed,
                           adjoint=diffrax.ForwardMode(), **self.method())
        return {name: r.value(name, lattice, run) for name, r in records.items()}

    def lattice(self, values: dict[Target, Any]) -> Lattice:
        """The scene of one lane."""
        own = {name: Material(name, *numbers) for name, numbers in self.own.items()}
        lattice = self.scene.function(**self.scene.with_values(values, own))
        return lattice.counted_in(SI) if self.said == SI else lattice

    def state(self, lattice: Lattice, values: dict[Target, Any]) -> State:
        """The start of one lane."""
        return self.start.function(lattice, **self.start.with_values(values, {}))

    def until(self, lattice: Lattice, values: dict[Target, Any]) -> Any:
        """When a run ends."""
        until = values.get(UNTIL, self.run.get("until"))
        if not isinstance(until, tuple):
            return until
        return until[0] * math.prod(lattice.sites) + until[1]

    def method(self) -> dict[str, Any]:
        """Solver, step and tolerance, as far as the file says them."""
        method = {name: self.run[name] for name in ("step", "tolerance") if name in self.run}
        return method | ({"solver": getattr(solvers, self.run["solver"])()} if "solver" in self.run else {})


class Recipe(NamedTuple):
    """A sweep that stands in a file: `gx.sweep(recipe.function, recipe.parameters, units=recipe.units)`.

    - `title`; `function`: of the parameters by their names; `parameters`: the points; `units`: of both.
    - `store`, `picture`, `table`: names of files, `None` for none; `show`: the variable of the picture; `chunk`: lanes
      at a time, as in `gx.sweep`.
    """

    title: str
    function: Lane
    parameters: Points
    units: dict[str, str]
    store: str | None
    picture: str | None
    table: str | None
    show: str | None
    chunk: int | None

    def __str__(self) -> str:
        lane, points = self.function, self.parameters
        said = [self.title] * bool(self.title)
        said.append(f"{points.count} lanes of {lane.scene.kind!r}: {points!r}")
        said += [f"{name}: {r}" + f" [{r.unit}]" * bool(r.unit) for name, r in lane.records.items()]
        return "\n".join(said)

    def check(self) -> None:
        """Refuse scenes, starts and records that cannot be, at the first lane and at the ends of each parameter.

        Nothing is computed. What only some lanes refuse is marked there.
        """
        first = {name: x[0].item() for name, x in self.parameters.values(np.array([0])).items()}
        lanes = [first]
        for name, row in self.parameters.axes.items():
            ends = [row.min(), row.max()] if row.dtype.kind == "f" else np.unique(row)[:LOOKED_AT]
            lanes += [{**first, name: x.item()} for x in ends]
        for lane in lanes:
            _looked_at(self.function, lane, lane is first)


@checked
def recipe(path: str | Path) -> Recipe:
    """The sweep that stands in a TOML file; tables and keys as in the README. Nothing in it is executed.

    **Raises** ValueError for what is no such file, unknown keys (with the nearest known one) and values of another
    kind, each with its place in the file.
    """
    return named(path, lambda: recipe_of(tables(path)))


def named(path: str | Path, call: Callable[[], Any]) -> Any:
    """What a call gives; its refusal names the file."""
    try:
        return call()
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix('FILE: ')}") from None


def recipe_of(values: dict[str, Any]) -> Recipe:
    """The sweep of a file's tables."""
    file = Table("", values)
    file.only(TABLES)
    scene_table = file.table("scene")
    own = _materials(file)
    scene = call_of(scene_table, "scene", SCENES, ("units",))
    said = said_of(scene_table, scene.kind)
    start = call_of(file.table("start"), "start", STARTS) if "start" in file else None
    vary = file.table("vary")
    places = targets(vary, scene, start)
    for call in (scene, start):
        if call is not None:
            needed(call, {t.argument for t in places if t.of == call.table and t.element is None})
    points = _points(file, vary, places, scene, start)
    if UNTIL in places and not (points.axes[UNTIL.name] > 0).all():
        refuse("[vary] run.until", "numbers above zero", f"{points.axes[UNTIL.name].min():g}")
    records = _records(file, said, scene, start)
    run = _run(file, start, records, UNTIL in places)
    units = {t.name: unit_of(t, said) for t in places} | {name: r.unit for name, r in records.items()}
    taken = {t.name for t in places} & records.keys()
    if taken:
        refuse(f"[record] {taken.pop()}", "a name of its own", "that of a parameter")
    function = Lane(scene, start, said, own, {t.name: t for t in places}, run, records)
    title = file.text("title", "")
    return Recipe(title, function, points, {k: u for k, u in units.items() if u}, **_result(file, records))


def _materials(file):
    """Materials of the file's own: {name: (young, poisson, density)}."""
    found = {}
    for name in (file.table("materials").values if "materials" in file else {}):
        table = file.table("materials").table(name)
        table.only(["young", "poisson", "density"])
        found[name] = tuple(table.number(key) for key in ("young", "poisson", "density"))
        _prefixed(table.where, lambda name=name: Material(name, *found[name]))
    return found


def _prefixed(where, call):
    try:
        return call()
    except ValueError as error:
        raise ValueError(f"{where} {error}") from None


def _points(file, vary, places, scene, start):
    """The lanes that [vary] and [design] say."""
    design = file.table("design", {})
    kind = design.word("kind", ("grid", "paired", "random"), "grid")
    design.only(["kind"] + ["count", "seed"] * (kind == "random"))
    if not places:
        refuse("[vary]", "what varies, such as ratio = {from = 0.1, to = 1.0, count = 64}", "nothing")
    if kind == "random":
        bounds = {t.name: _bounds(f"[vary] {t.name}", x, values_kind(t, scene, start)) for t, x in places.items()}
        count = design.whole("count", at_least=1, most=MOST_VALUES)
        return random(bounds, count, seed=design.whole("seed", 0, 0, MOST_SEED))
    rows = {t.name: _row(f"[vary] {t.name}", x, values_kind(t, scene, start)) for t, x in places.items()}
    if kind == "paired":
        return _prefixed("[vary]", lambda: paired(rows))
    for name, row in rows.items():
        if len(np.unique(row)) < len(row):
            refuse(f"[vary] {name}", "different values", "some of them twice", 'Lists side by side: kind = "paired".')
    lanes = math.prod(map(len, rows.values()))
    if lanes > MOST_LANES:
        refuse("[vary]", f"at most {MOST_LANES} combinations", str(lanes), 'A random design of them: kind = "random".')
    return points_of(rows)


def _bounds(place, value, p):
    table = Table(place, value)
    table.only(["from", "to", "scale"])
    low, high = (plain(table.place(key), table.get(key), p) for key in ("from", "to"))
    scale = table.word("scale", ("linear", "log"), "linear")
    if not all(isinstance(x, (int, float)) for x in (low, high)) or not low < high or scale == "log" and low <= 0:
        refuse(place, "from below to, both above zero on a logarithmic scale", f"{described(low)}, {described(high)}")
    return (low, high, scale) if scale == "log" else (low, high)


def _row(place, value, p):
    """The values of one parameter, as an array of one kind."""
    if isinstance(value, dict):
        return _spaced(Table(place, value), p)
    if not isinstance(value, list):
        refuse(place, "a list, or {from = ..., to = ..., count = ...}", described(value),
               "What does not vary belongs into [scene] or [start].")
    if len(value) > MOST_VALUES:
        refuse(place, f"at most {MOST_VALUES} values", str(len(value)))
    found = plain(place, value, p)
    if not all(isinstance(x, str) for x in found) and not all(isinstance(x, (int, float)) for x in found):
        refuse(place, "numbers or words", described(value))
    return np.array(found)


def _spaced(table, p):
    table.only(["from", "to", "count", "scale"])
    low, high = (table.number(key) for key in ("from", "to"))
    count = table.whole("count", at_least=1, most=MOST_VALUES)
    scale = table.word("scale", ("linear", "log"), "linear")
    if low == high and count > 1:
        refuse(table.where, "from and to that differ", f"{low:g} twice")
    if scale == "log" and not (low > 0 and high > 0):
        refuse(table.where, "from and to above zero on a logarithmic scale", f"{low:g}, {high:g}")
    with np.errstate(all="ignore"):
        row = (np.geomspace if scale == "log" else np.linspace)(low, high, count)
    if not np.isfinite(row).all():
        refuse(table.where, "numbers whose difference is a number", f"{low:g}, {high:g}")
    takes = kinds(p)
    if not takes & {float, int}:
        refuse(table.where, "a list of words", "numbers")
    if float not in takes:
        row = np.unique(np.round(row))
        return np.array([plain(table.where, int(x), p) for x in row])
    return row


def _records(file, said, scene, start):
    record = file.table("record")
    if not record.values:
        refuse("[record]", 'what is recorded, such as force = {kind = "peak", of = "contact_force"}', "nothing")
    found = {}
    for name in record.values:
        if not name.isidentifier() or name in ("lane", "reason", "outcome"):
            refuse("[record]", "names of letters, digits and underscores, none of lane, reason, outcome", repr(name))
        found[name] = _relative(record.table(name), record_of(record.table(name), said), scene, start)
    return found


def _relative(table, found, scene, start):
    """A record, its reference by the arguments that are changed for it."""
    where, places = table.place("relative_to"), {}
    for key, value in found.relative_to:
        target = target_of(where, key, scene, start)
        one = plain(f"{where} {key}", value, values_kind(target, scene, start))
        if not isinstance(one, (int, float, str)):
            refuse(f"{where} {key}", "a number or a word", described(value))
        places[target] = one
    return found._replace(relative_to=tuple(places.items()))


def _run(file, start, records, varied):
    """When a run ends, and how it is computed; nothing where no record needs one."""
    if not any(r.runs for r in records.values()):
        for name in ("start", "run"):
            if name in file:
                refuse(f"[{name}]", "a record that needs a run, such as a peak", "none")
        return {}
    if start is None:
        refuse("[start]", 'a start of the runs, such as kind = "impact"', "none")
    run = file.table("run", {} if varied else REQUIRED)
    run.only(["until", "tolerance", "step", "solver"])
    if varied:
        found = {}
    elif isinstance(run.get("until"), dict):
        until = run.table("until")
        until.only(["per_bead", "plus"])
        found = {"until": (until.above_zero("per_bead"), until.number("plus", 0.0))}
        if found["until"][1] < 0:
            refuse(until.place("plus"), "a number not below zero", f"{found['until'][1]:g}")
    else:
        found = {"until": run.above_zero("until")}
    if "tolerance" in run and "step" in run:
        refuse("[run]", "a tolerance or a step", "both")
    for name in ("tolerance", "step"):
        if name in run:
            found[name] = run.above_zero(name)
    if found.get("tolerance", 0) >= 0.1:
        refuse("[run] tolerance", "a number below 0.1", f"{found['tolerance']:g}", "Typical: 1e-8.")
    return found | ({"solver": run.word("solver", SOLVERS)} if "solver" in run else {})


def _result(file, records):
    result = file.table("result", {})
    result.only([*ENDINGS, "show", "chunk"])
    names = {}
    for key, endings in ENDINGS.items():
        name = names[key] = result.text(key, None)
        if name is None:
            continue
        if name != Path(name).name or "\\" in name or not name.isprintable() or len(name) > 100:
            refuse(result.place(key), "a file's name without folders", described(name), "--out says where it goes.")
        if not name.endswith(endings) or name in endings:
            refuse(result.place(key), f"a name ending in {' or '.join(endings)}", described(name))
    show = result.word("show", records, None)
    return {**names, "show": show, "chunk": result.whole("chunk", None, 1, MOST_VALUES)}


def _looked_at(function, lane, measured):
    """Build the scene of a lane, its start and its records as shapes alone."""
    placed = {function.targets[name]: x for name, x in lane.items()}
    at = ", ".join(f"{name} = {x:.6g}" if isinstance(x, float) else f"{name} = {x}" for name, x in lane.items())

    def build():
        lattice = _prefixed(f"[scene] at {at}:", lambda: function.lattice(placed))
        if function.start is None:
            return lattice
        state = _prefixed(f"[start] at {at}:", lambda: function.state(lattice, placed))
        if measured:
            for name, r in function.records.items():
                if r.record is not None:
                    _prefixed(f"[record.{name}]", lambda r=r: r.record.value(0.0, state, lattice))
        return lattice, state

    try:
        jax.eval_shape(build)
    except TypeError as error:  # of what is not computed from shapes alone
        if not isinstance(error, jax.errors.JAXTypeError):
            raise ValueError(f"[scene] at {at}: {' '.join(str(error).split())[:200]}") from None
