"""What a sweep's file says of the scene, of the start and of what varies in them."""

import inspect
import re
from collections.abc import Callable
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp

from ... import scenes, states
from ...checks import described, refuse
from ...materials import Material
from ...units import SCALED, SI
from .keys import LEAST, MOST, Table, number, whole

SCENES = {name: getattr(scenes, name) for name in (
    "beads", "defects", "dimer", "disordered", "fput", "monomer", "n_to_one", "pattern", "taper", "toda", "trimer")}
STARTS = {name: getattr(states, name) for name in (
    "impact", "kdv_soliton", "normal_mode", "random", "rest", "sine_mode", "solitary_wave", "strain_step", "thermal",
    "toda_soliton", "velocity_step", "wave_packet")}
# of a chain, and what says how many it has
MOST_SITES, SIZES = 10_000_000, ("sites", "cells")
# units of arguments by their names, where the numbers are those of SI
UNITS = {
    "radii": "m", "precompression": "N", "damping_time": "s", "mass": "kg", "masses": "kg", "temperature": "J",
    "rate": "1/m", "strength": "N",
}
START_UNITS = {"velocity": "m/s", "displacement": "m", "temperature": "J", "left": "m", "right": "m", "c": "m/s"}
_TARGET = re.compile(r"(?:(scene|start|run)\.)?([A-Za-z]\w*)(?:\[(\d{1,9})\])?")


# when a run ends may vary too
UNTIL = {"until": inspect.Parameter("until", inspect.Parameter.KEYWORD_ONLY, annotation=float)}


class Target(NamedTuple):
    """An argument of the scene or of the start, or one element of it; or when the run ends."""

    of: str
    argument: str
    element: int | None

    @property
    def name(self) -> str:
        """What the coordinate is called: ratio, radii_1, start_velocity, run_until."""
        parts = [self.of] * (self.of != "scene") + [self.argument] + [str(self.element)] * (self.element is not None)
        return "_".join(parts)


class Call(NamedTuple):
    """A function of granjax and its arguments as they stand in the file."""

    table: str
    kind: str
    arguments: dict[str, Any]

    @property
    def function(self) -> Callable:
        """The scene or the state of this kind."""
        return (SCENES if self.table == "scene" else STARTS)[self.kind]

    def with_values(self, values: dict[Target, Any], own: dict[str, Material]) -> dict[str, Any]:
        """The arguments, with those of one lane and the file's own materials in their places."""
        found = dict(self.arguments)
        for target, value in values.items():
            if target.of != self.table:
                continue
            if target.element is None:
                found[target.argument] = value
            elif isinstance(found[target.argument], dict):
                found[target.argument] = {**found[target.argument], target.element: value}
            else:
                row = list(found[target.argument])
                row[target.element] = value
                found[target.argument] = row
        return {name: _argument(x, own) for name, x in found.items()}


def _argument(x, own):
    if isinstance(x, list):
        if any(isinstance(y, jax.Array) for y in x):
            return jnp.stack([jnp.asarray(y, float) for y in x])
        return [own.get(y, y) if isinstance(y, str) else y for y in x]
    return own.get(x, x) if isinstance(x, str) else x


def call_of(table: Table, name: str, known: dict[str, Callable], other: tuple[str, ...] = ()) -> Call:
    """The function that a table names by its `kind`, with its arguments checked by their names and kinds."""
    kind = table.word("kind", known)
    own = arguments_of(known[kind])
    table.only(["kind", *other, *own])
    found = {}
    for key, value in table.values.items():
        if key in own:
            found[key] = plain(table.place(key), value, own[key])
    return Call(name, kind, found)


def arguments_of(function: Callable) -> dict[str, inspect.Parameter]:
    """The arguments of a scene or of a state that a file can give, by their names."""
    found = inspect.signature(function).parameters
    return {name: p for name, p in found.items() if name not in ("lattice", "field")}


def needed(call: Call, varied: set[str]) -> None:
    """Refuse a call for which an argument without default is missing."""
    for name, p in arguments_of(call.function).items():
        if p.default is inspect.Parameter.empty and name not in call.arguments and name not in varied:
            refuse(f"[{call.table}] {name}", f"a value, which {call.kind!r} needs", "none")


def kinds(p: inspect.Parameter) -> set[Any]:
    """The plain types that an argument takes: float, int, str."""
    return {t for t in (float, int, str) if t in _types(p.annotation)}


def _types(annotation):
    inner = get_args(annotation)
    return {annotation} | {t for x in inner for t in _types(x)}


def plain(place: str, value: Any, p: inspect.Parameter) -> Any:
    """A value of the file as an argument: numbers as floats, but where whole ones are meant."""
    if isinstance(value, list):
        if not value:
            refuse(place, "a list of some values", "an empty one")
        return [plain(f"{place}[{i}]", x, p) for i, x in enumerate(value)]
    if isinstance(value, dict):
        if not all(key.isdecimal() and key.isascii() and len(key) < 10 for key in value) or not value:
            refuse(place, "a value, or numbers by the index of their site, such as {10 = 0.5}", described(value))
        return {int(key): number(f"{place}.{key}", x) for key, x in value.items()}
    takes = kinds(p)
    if isinstance(value, str):
        if str not in takes:
            refuse(place, "a number" if takes else "another value", described(value))
        return value
    if str in takes and not takes & {float, int}:
        refuse(place, "a word", described(value))
    if int in takes and float not in takes:
        sized = p.name in SIZES
        return whole(place, value, 1 if sized else LEAST, MOST_SITES if sized else MOST)
    return number(place, value)


def targets(vary: Table, scene: Call, start: Call | None) -> dict[Target, Any]:
    """What varies, as it stands in the file, by the argument it is of."""
    flat = {}
    for key, value in vary.values.items():
        if key in ("scene", "start", "run") and isinstance(value, dict):
            flat |= {f"{key}.{inner}": x for inner, x in value.items()}
        else:
            flat[key] = value
    found = {}
    for key, value in flat.items():
        target = target_of(vary.where, key, scene, start)
        if any(target.name == other.name for other in found):
            refuse(vary.where, "each argument once", described(key))
        found[target] = value
    return found


def target_of(where: str, key: str, scene: Call, start: Call | None) -> Target:
    """The argument of a name such as ratio, radii[1], start.velocity."""
    parts = _TARGET.fullmatch(key)
    known = {name: "scene" for name in arguments_of(scene.function)}
    if start is not None:
        known |= {f"start.{name}": "start" for name in arguments_of(start.function)} | {"run.until": "run"}
    name = "" if parts is None else f"{parts[1]}.{parts[2]}" if parts[1] in ("start", "run") else parts[2]
    if name not in known:
        Table(where, {name or key: None}).only(known)
    if known[name] == "run" and parts[3] is None:
        return Target("run", "until", None)
    call = {"scene": scene, "start": start}.get(known[name], Call("run", "", {}))
    target = Target(call.table, parts[2], None if parts[3] is None else int(parts[3]))
    if target.element is not None:
        held = call.arguments.get(target.argument)
        there = range(len(held)) if isinstance(held, list) else held if isinstance(held, dict) else ()
        if target.element not in there:
            refuse(f"{where} {key}", f"an element of a list [{call.table}] {target.argument}", described(held),
                   "Elements are counted from 0.")
    return target


def values_kind(target: Target, scene: Call, start: Call | None) -> inspect.Parameter:
    """The argument that a target is, with what it takes."""
    if target.of == "run":
        return UNTIL[target.argument]
    call = scene if target.of == "scene" else start
    return arguments_of(call.function)[target.argument]


def unit_of(target: Target, said: str) -> str:
    """The unit of a coordinate; "" of pure numbers, of scaled ones, and where nobody knows."""
    table = {"scene": UNITS, "start": START_UNITS, "run": {"until": "s"}}[target.of]
    return table.get(target.argument, "") if said == SI else ""


def said_of(table: Table, kind: str) -> str:
    """Whether the numbers of a scene are those of SI."""
    if kind == "beads":
        return table.word("units", (SI,), SI)
    return table.word("units", (SI, SCALED), SCALED)
