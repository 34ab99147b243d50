"""What a sweep's file records: of a run a quantity's peak and the like, of the scene at rest its linear waves."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ... import linear, measures
from ...checks import one_of, refuse
from ...flow import Arrival, Integral, Lowest, Peak, Run
from ...lattice import Lattice
from ...units import SI
from ...units.names import known_unit, named_unit
from .keys import Table, whole

BOND, SITE, WHOLE = "bond", "site", ""
# {name: (what an index counts, unit)}
QUANTITIES = {
    "contact_force": (BOND, "N"), "overlap": (BOND, "m"), "strain": (BOND, "m"), "velocity": (SITE, "m/s"),
    "displacement": (SITE, "m"), "site_energy": (SITE, "J"), "energy": (WHOLE, "J"), "kinetic_energy": (WHOLE, "J"),
    "potential_energy": (WHOLE, "J"), "momentum": (WHOLE, "kg m/s"), "participation_number": (WHOLE, ""),
    "energy_centre": (WHOLE, ""), "second_moment": (WHOLE, ""),
}
RUN = {"peak": Peak, "lowest": Lowest, "integral": Integral, "arrival": Arrival, "final": None}
# {name: (what an index counts, unit)}
REST = {
    "sound_speed": ("", "1/s"), "lower_edge": ("band", "rad/s"), "upper_edge": ("band", "rad/s"),
    "mode_frequency": ("mode", "rad/s"),
}
MOST_INDEX, MOST_LIST = 10**9, 1000


class Recorded(NamedTuple):
    """One result: its kind, its quantity and index, a threshold, the unit, and what it is divided by the value at."""

    kind: str
    of: str
    index: tuple[int, ...] | int | None
    threshold: float | None
    size: float
    unit: str
    relative_to: tuple[tuple[str, Any], ...]

    def __str__(self) -> str:
        counted = (QUANTITIES[self.of] if self.runs else REST[self.kind])[0]
        where = f", {counted} {self.index}" if self.index is not None else f", every {counted}" if counted else ""
        relative = ", ".join(f"{target.name} = {x}" for target, x in self.relative_to)
        return f"{self.kind}{' of ' + self.of if self.of else ''}{where}" + f", relative to {relative}" * bool(relative)

    @property
    def runs(self) -> bool:
        """Whether it needs a run."""
        return self.kind in RUN

    @property
    def record(self) -> Any:
        """What `simulate` is to follow; `None` for what is read from its end or from the scene."""
        if not self.runs or self.kind == "final":
            return None
        quantity = followed(self.of, self.index)
        return Arrival(quantity, self.threshold) if self.kind == "arrival" else RUN[self.kind](quantity)

    def value(self, name: str, lattice: Lattice, run: Run | None) -> jax.Array:
        """The result of one lane; NaN where its run did not complete."""
        if not self.runs:
            return at_rest(self.kind, self.index, lattice) / self.size
        if self.kind == "final":
            found = followed(self.of, self.index)(run.ts[-1], run.final, lattice)
        else:
            found = run.recorded[name]
        return jnp.where(run.completed, found, jnp.nan) / self.size


@cache
def followed(of: str, index: tuple[int, ...] | int | None) -> Callable:
    """A quantity as a function (t, y, lattice): one function for one quantity, so that nothing compiles twice."""

    def quantity(t, y, lattice):
        if of in ("velocity", "displacement"):
            found = y.v if of == "velocity" else y.u
        else:
            found = getattr(measures, of)(lattice, y, t)
        return _picked(QUANTITIES[of][0], found, index)

    return quantity


def _picked(counted, found, index):
    """One of several, some of them, or all."""
    if index is None:
        return found
    for i in index if isinstance(index, tuple) else [index]:
        if not -found.shape[0] <= i < found.shape[0]:
            refuse(counted, f"an index within {-found.shape[0]} ... {found.shape[0] - 1}", str(i))
    return jnp.stack([found[i] for i in index]) if isinstance(index, tuple) else found[index]


def at_rest(kind: str, index: tuple[int, ...] | int | None, lattice: Lattice) -> jax.Array:
    """Linear waves about rest: long waves' speed in sites, edges of bands, frequencies of modes."""
    if kind == "sound_speed":
        return linear.sound_speed(lattice)
    found = linear.normal_modes(lattice).omega if kind == "mode_frequency" else getattr(
        linear.bands(lattice), kind.removesuffix("_edge"))
    return _picked(REST[kind][0], found, index)


def record_of(table: Table, said: str) -> Recorded:
    """One of the file's records. `said`: whether the numbers are those of SI."""
    kind = table.word("kind", (*RUN, *REST))
    own = ["kind", "unit", "relative_to"]
    of, threshold = "", None
    if kind in RUN:
        own += ["of"] + ["threshold"] * (kind == "arrival")
        of = table.word("of", QUANTITIES)
        counted, unit = QUANTITIES[of]
    else:
        counted, unit = REST[kind]
    table.only(own + [counted] * bool(counted))
    if kind == "arrival":
        threshold = table.number("threshold")
    unit = "s" if kind == "arrival" else f"{unit} s".strip() if kind == "integral" else unit
    index = _index(table, counted) if counted else None
    relative = table.table("relative_to").values if "relative_to" in table else {}
    if "relative_to" in table and not relative:
        refuse(table.place("relative_to"), "values of the scene's arguments, such as {ratio = 1.0}", "none")
    size, unit = _unit(table, unit, said, bool(relative))
    return Recorded(kind, of, index, threshold, size, unit, tuple(relative.items()))


def _index(table, counted):
    """One index, a tuple of several, `None` for all."""
    if not isinstance(table.get(counted, None), list):
        return table.whole(counted, None, -MOST_INDEX, MOST_INDEX)
    place, found = table.place(counted), table.get(counted)
    if not 0 < len(found) <= MOST_LIST:
        refuse(place, f"1 to {MOST_LIST} indices", str(len(found)))
    return tuple(whole(f"{place}[{i}]", x, -MOST_INDEX, MOST_INDEX) for i, x in enumerate(found))


def _unit(table, unit, said, relative):
    """The size of the unit that is asked for, and its name; "" for scaled numbers."""
    if relative:
        if "unit" in table:
            refuse(table.place("unit"), "none beside relative_to, which makes a pure number", repr(table.get("unit")))
        return 1.0, ""
    if "unit" not in table:
        return 1.0, unit if said == SI else ""
    asked = named_unit(table.place("unit"), table.text("unit"))
    if said != SI:
        refuse(table.place("unit"), "none for scaled numbers", repr(asked.name), 'SI: kind = "beads", or units = "SI".')
    if not unit:
        refuse(table.place("unit"), "none for a pure number", repr(asked.name))
    known = known_unit(unit)
    if asked.dimension != known.dimension:
        one_of(table.place("unit"), asked.name, (unit,))
    return asked.size / known.size, asked.name
