"""Bad input for every public callable, from its signature and types: what is given, and what becomes of it.

A valid call is made of the values of `VALID`, one argument at a time is replaced by each of `VALUES`, and the
annotation decides by `admits` whether it must be refused. Nothing of size is compiled: what comes as far as that was
accepted, a conversion or what else looks at an argument is not.
"""

import dataclasses
import datetime
import functools
import inspect
import random
import re
import signal
import tempfile
import types
import typing
from collections import abc
from contextlib import contextmanager
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import beartype.door
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.figure
import numpy as np
import scipy.io
import typed
from test_vocabulary import NAMES, public

import granjax as gx
from granjax.fit.problem import Problem
from granjax.orbits.guesses.envelope import Edge
from granjax.orbits.problems import Shooting
from granjax.parameters import Coordinates
from granjax.results import Result
from granjax.split_system import Split
from granjax.studies.reproduce import Figure, figure
from granjax.theory.nls_coefficients import Coefficients
from granjax.types import Pytree
from granjax.units import Dimensional
from granjax.work_precision import Ladder

# ---------------------------------------------------------------------------------------------------------- the face

# what is no part of the face, by the beginning of its name, and why
NOT_FACE = {
    "entry.": "the same",
    "cli.": "is given text by the shell", "notebook.": "asked by notebooks alone: tests/test_explore.py",
    "descent.": "a part of `fit` and `design`", "parameters.": "a part of `fit` and `design`",
    "printing.": "what prints: its input is anything", "variables.": "what names the arrays of results",
    "files.": "what writes", "exchange.formats.": "what writes", "exchange.by_name.": "what writes",
    "exchange.csv_table.": "what writes", "exchange.structure.": "what writes", "exchange.lazily.": "what reads",
    "reading.": "what reads", "interrupts.": "what answers Ctrl-C",
    "profiles.": "what `solitary_wave` asks, which has looked at everything",
    "programs.": "what compiles: what it is given is anything",
    "outside.": "for functions of the user's alone",
    "checks.": "what refuses: its input is anything",
    "split_system.": "between a lattice and a solver, inside of a loop",
    "lattice.model.Lattice.sum_forces": "a part of `force`, inside of a loop", "terms.reach.": "asked by terms alone",
    "lattice.model.Lattice.total": "a part of `force`, inside of a loop",
    "units.names.": "asked by results and plots, whose units= is a part of the face",
    **dict.fromkeys(("sweeps.chunk.", "sweeps.dataset.", "sweeps.executors.", "sweeps.function.", "sweeps.identity.",
                     "sweeps.plan.", "sweeps.points.Points", "sweeps.points.points_of", "sweeps.result.known",
                     "sweeps.result.S", "sweeps.store.", "sweeps.manifest.", "sweeps.chunk_file.", "sweeps.task.",
                     "flow.lifted."), "a part of `sweep`"),
    "tuning.keep_compiled": "sets where JAX keeps its programs, for the whole process",
    "tuning.one_thread": "a decorator of the library's own",
    "tuning.prepare_import": "called by the import, without an argument",
}


# classes whose constructor Equinox writes and a user calls
MADE = (gx.Arrival, gx.Peak, gx.Integral, gx.Lowest, gx.Flow, gx.orbits.Symmetry)
# whose methods are what a kind answers to the library, inside of traced programs, or the parts of a computation
KINDS = (
    gx.Law, gx.Term, gx.StrainMap, gx.Record, diffrax.AbstractSolver, Shooting, Problem,
    Dimensional, Coordinates, Split, gx.first_order.Equation,
)


class Target(NamedTuple):
    """A public callable: the module that shows it, its name there, and the class whose method it is."""

    module: str
    name: str
    function: object
    cls: type | None

    @property
    def key(self):
        return f"{self.function.__module__.removeprefix('granjax.')}.{self.name}"

    def arguments(self):
        """Parameters that can be given, without `self`."""
        return {p.name: p for p in inspect.signature(self.function).parameters.values()
                if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name not in ("self", "cls")}


def targets():
    """Functions, classes that a user makes, and methods with arguments, each once."""
    seen = set()
    for module in NAMES:
        for value in public(module):
            name, where = getattr(value, "__qualname__", ""), value.__module__
            if not name or (where, name) in seen or not callable(value):
                continue
            seen.add((where, name))
            found = [Target(module, name, value, None)]
            if inspect.isclass(value):
                found = [] if not made_by_user(value) else found
                kind = issubclass(value, KINDS)
                found += [] if kind else [Target(module, f"{name}.{k}", v, value) for k, v in vars(value).items()
                          if inspect.isfunction(v) and not k.startswith("_") and v.__qualname__.startswith(name)]
            yield from (t for t in found if t.arguments() and not any(t.key.startswith(x) for x in NOT_FACE))


def made_by_user(cls):
    """Whether a class has a constructor of our own; others are records that the library makes, or JAX rebuilds."""
    own = vars(cls).get("__init__")
    written = inspect.isfunction(own) and "granjax" in inspect.unwrap(own).__code__.co_filename
    return cls in MADE or written and not issubclass(cls, Result)


# -------------------------------------------------------------------------------------------------------- wrong values


def _generator():
    yield 1.0


class Frame:
    """Looks like pandas: has values and an index, and is no array."""

    values, index, columns = [1.0], [0], ["a"]

    def __len__(self):
        return 1

    def __iter__(self):
        return iter(self.columns)

    def __getitem__(self, name):
        return self.values


def _endless():
    inside = []
    inside.append(inside)
    return inside


SITES, FRAMES = 5, 17


@functools.cache
def lattice():
    return gx.scenes.monomer(SITES, precompression=0.3)


@functools.cache
def fields():
    """A lattice whose cells hold two beads by their names."""
    return gx.Lattice({"a": np.ones(SITES), "b": np.ones(SITES)}, gx.Bond(gx.Shift(1, "fixed", "a"), gx.Linear(1.0)))


@functools.cache
def lattices():
    """Two lattices as lanes."""
    return jax.vmap(lambda k: gx.scenes.monomer(SITES, stiffness=k, precompression=0.3), out_axes=-1)(np.ones(2))


VALUES = {
    "None": lambda: None,
    "True": lambda: True,
    "text": lambda: "text",
    "bytes": lambda: b"x",
    "[]": list,
    "{}": dict,
    "()": tuple,
    "object": object,
    "lambda": lambda: lambda: None,
    "class": lambda: Frame,
    "1j": lambda: 1j,
    "complex array": lambda: np.ones(5) * 1j,
    "complex jax array": lambda: jnp.asarray(np.ones(5) * 1j),
    "complex128": lambda: np.complex128(1j),
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "-1": lambda: -1,
    "-1.5": lambda: -1.5,
    "0": lambda: 0,
    "2.5": lambda: 2.5,
    "10**400": lambda: 10**400,
    "2**63": lambda: 2**63,
    "2**62": lambda: 2**62,
    "1e308": lambda: 1e308,
    "ragged": lambda: [[1.0], [1.0, 2.0]],
    "object array": lambda: np.array([1.0, None], dtype=object),
    "masked": lambda: np.ma.array(np.ones(5), mask=[0, 0, 0, 0, 1]),
    "texts": lambda: np.array(["a", "b"]),
    "list of texts": lambda: ["a", "b"],
    "list of None": lambda: [None, None],
    "bools": lambda: np.array([True, False]),
    "wrong length": lambda: np.ones(7),
    "wrong rank": lambda: np.ones((2, 3, 4)),
    "nan array": lambda: np.full(5, np.nan),
    "empty": lambda: np.zeros(0),
    "empty rows": lambda: np.zeros((0, 3)),
    "one in an array": lambda: np.ones(1),
    "date": lambda: datetime.datetime(2020, 1, 1),
    "dates": lambda: np.array(["2020-01-01"], "datetime64[D]"),
    "decimal": lambda: Decimal("1.5"),
    "fraction": lambda: Fraction(3, 2),
    "lattice": lattice,
    "lattice of fields": fields,
    "lattices": lattices,
    "state": lambda: gx.State(np.zeros(5), np.zeros(5)),
    "state of seven": lambda: gx.State(np.zeros(7), np.zeros(7)),
    "state of texts": lambda: gx.State(np.array(["a"] * 5), np.zeros(5)),
    "state of fields": lambda: gx.State({"a": np.zeros(5)}, {"a": np.zeros(5)}),
    "law": lambda: gx.Hertz(),
    "generator": _generator,
    "frame": Frame,
    "set": lambda: {1.0, 2.0},
    "path": lambda: Path("no such folder") / "file",
    "endless": _endless,
    "range": lambda: range(3),
    "slice": lambda: slice(2),
    "Ellipsis": lambda: ...,
    "module": lambda: np,
    "gives text": lambda: lambda *x: "text",
    "gives None": lambda: lambda *x: None,
    "dict of texts": lambda: {"a": "b"},
    "dict of numbers": lambda: {1: 2},
}
# values under a transformation, by what is traced
TRACED = {"traced number": 1.0, "traced count": 3, "traced array": np.ones(5)}

# --------------------------------------------------------------------------------------------------- what a type admits


def numeric(x, kinds="iuf"):
    """Whether a list is one of numbers, nested evenly."""
    try:
        return np.asarray(x).dtype.kind in kinds
    except (ValueError, TypeError, OverflowError, RecursionError):
        return False


def takes(function, count):
    """Whether a function can be called with so many arguments."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:
        return True
    return True


def admits(hint, x):
    """Whether a value is of the kind that an annotation names; what is not must be refused."""
    if hint in (typing.Any, object, inspect.Parameter.empty):
        return True
    if isinstance(hint, str):
        return True
    if hint in (None, type(None)):
        return x is None
    origin, inside = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        # numbers or a list: a list of numbers
        if float in inside and abc.Sequence in inside and isinstance(x, abc.Sequence) and not isinstance(x, str):
            return not isinstance(x, bytes) and numeric(x)
        return any(admits(one, x) for one in inside)
    if origin is typing.Annotated:
        return admits(inside[0], x)
    if hint in (int, np.integer):
        return isinstance(x, (int, np.integer)) and not isinstance(x, bool)
    if hint in (float, np.number):
        return isinstance(x, (int, float, np.integer, np.floating)) and not isinstance(x, bool)
    if hint in (bool, np.bool_):
        return isinstance(x, (bool, np.bool_))
    if origin is abc.Callable and inside[0] is not Ellipsis:
        return callable(x) and takes(x, len(inside[0]))
    if origin is abc.Callable or hint is abc.Callable:
        return callable(x)
    if origin in (abc.Sequence, list, tuple, abc.Iterable) or hint in (abc.Sequence, abc.Iterable, tuple, list):
        kind = origin or hint
        if isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer):
            x = np.asarray(x)
        array = kind in (abc.Sequence, abc.Iterable) and isinstance(x, np.ndarray) and x.ndim > 0
        if isinstance(x, (str, bytes)) or not (array or isinstance(x, kind)):
            return False
        if not inside or inside == ((),):
            return True
        if kind is tuple and inside[-1] is not Ellipsis:
            return len(x) == len(inside) and all(map(admits, inside, x))
        return all(admits(inside[0], one) for one in x)
    if origin in (dict, abc.Mapping):
        return isinstance(x, origin) and all(admits(inside[0], k) and admits(inside[1], v) for k, v in x.items())
    if isinstance(x, np.ma.MaskedArray):
        return hint is np.ndarray
    if hint is Pytree:
        try:
            leaves = jax.tree.leaves(x)
        except SystemError:  # a list that holds itself
            return False
        return bool(leaves) and all(isinstance(leaf, jax.Array) or numeric(leaf, "iufc") for leaf in leaves)
    if beartype.door.is_bearable(x, hint) or not hasattr(hint, "dim_str") or not isinstance(x, (np.ndarray, jax.Array)):
        return beartype.door.is_bearable(x, hint)
    # JAX's arrays are as good as NumPy's where they are known, and whole numbers are real ones
    x = np.asarray(x) if isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer) else x
    return beartype.door.is_bearable(x.astype(float) if x.dtype.kind in "iu" else x, hint)


# -------------------------------------------------------------------------------------------------------- valid values


def times():
    return np.linspace(0.0, 1.0, FRAMES)


def histories():
    return np.random.default_rng(0).normal(size=(FRAMES, SITES))


def traces():
    return gx.Traces(times=times(), velocity=np.zeros((FRAMES, 2)), sites=[1, 2], sigma=0.1)


def scene(parameters):
    return gx.scenes.monomer(5, stiffness=parameters["stiffness"], precompression=0.3)


def shaken(omega):
    return gx.driven.driven_chain(lattice(), 0.01, omega, damping=0.1)


def y():
    return gx.State(np.zeros(5), np.zeros(5))


def run():
    known = dict(
        ts=jnp.asarray(times()), us=jnp.asarray(histories()), vs=jnp.asarray(histories()), final=y(), recorded={},
        energy_error=jnp.asarray(0.0), code=jnp.asarray(0), stats={"steps": 8}, failed_at=None, solver="", choice="",
        remark="", unseen="", _margin=jnp.asarray(1.0), _short={}, _zone=0.0,
    )
    return gx.Run(**{field.name: known.get(field.name) for field in dataclasses.fields(gx.Run)})


@functools.cache
def shock():
    return gx.shocks.velocity_shock(lattice(), 0.1)


def envelope(nu2=1.0):
    """Coefficients of a nonlinear Schroedinger equation, of a chain with one site per cell."""
    known = dict(k=jnp.pi, omega=1.0, nu2=nu2, nu3=1.0, nu3_force=1.0, group_velocity=0.0, resonant=False, bond=0)
    arrays = {field.name: jnp.asarray(known[field.name]) if field.name in known else jnp.ones(1, complex)
              for field in dataclasses.fields(Coefficients) if not field.name.startswith("_")}
    return Coefficients(**arrays)


def fitted():
    """What the pictures of a fit read."""
    signal = np.zeros((FRAMES, 2))
    return types.SimpleNamespace(
        traces=(traces(),), signals=(signal,), residuals=(signal,), parameters={"a": 1.0, "b": 2.0}, names=("a", "b"),
        covariance=np.eye(2))


@functools.cache
def folder():
    """A folder with a file of either kind, removed at the end."""
    made = tempfile.TemporaryDirectory()
    np.savetxt(Path(made.name) / "file.csv", np.column_stack([times(), histories()]), delimiter=",")
    scipy.io.savemat(Path(made.name) / "file.mat", {"t": times(), "v": histories()[:, 0]})
    gx.exchange.save(frames(), Path(made.name) / "saved.nc")
    return made


def frames():
    """A run's dataset."""
    import xarray

    return xarray.Dataset({name: (("time", "site"), histories()) for name in "uv"}, {"time": ("time", times())})


def file(name):
    return Path(folder().name) / name


@functools.cache
def kept():
    """The store of a sweep."""
    gx.sweep(lambda x: 2 * x, {"x": [1.0, 2.0]}, store=file("kept"), lanes=False, progress=False)
    return file("kept")


VALID = {
    "equation": lambda: gx.first_order.DNLS(SITES),
    "lattice": lattice, "state": y, "y": y, "run": run, "traces": traces, "scene": lambda: scene,
    "make": lambda: shaken, "law": lambda: gx.Hertz(1.0, 0.3), "sites": lambda: 5, "start": lambda: {"stiffness": 1.0},
    "ts": times, "times": times, "t": lambda: 0.0, "t0": lambda: 0.0, "t1": lambda: 1.0, "period": lambda: 6.0,
    "omega": lambda: 1.0, "k": lambda: 0.5, "q": histories, "qs": histories, "us": histories, "vs": histories,
    "material": lambda: "steel 316", "material_1": lambda: "steel 316", "family": lambda: "power law",
    "u": lambda: np.zeros(5), "v": lambda: np.zeros(5), "solver": gx.SRKN6b, "function": lambda: lambda x: x,
    "residual": lambda: lambda x, *rest: x, "objective": lambda: lambda p: p["stiffness"] ** 2,
    "flow": lambda: gx.Flow(8),
    "frames": lambda: 4, "steps": lambda: 8, "guess": y, "path": lambda: "file.csv", "high": lambda: 0.6,
    "strain_map": lambda: gx.Shift(1, "free"), "pairs": lambda: gx.Shift(1, "free"), "beads": lambda: 2,
    "measure": lambda: gx.measures.energy, "mass": lambda: 1.0, "cells": lambda: 9, "count": lambda: 2,
    "masses": lambda: [1.0, 0.5], "offset": lambda: 1, "tail": lambda: [0, 1], "head": lambda: [1, 2],
    "vector": lambda: [1.0, 0.0], "terms": lambda: (gx.Damping(0.1),), "term": lambda: gx.Damping(0.1),
    "modulation": lambda: lambda t: 1.0, "waveform": lambda: lambda t: 0.0, "site": lambda: 1,
    "quantity": lambda: gx.measures.energy, "knots": lambda: [-1.0, 0.0, 1.0], "name": lambda: "steel 316",
    "values": lambda: np.array([0.8, 0.9]), "ratios": lambda: np.array([0.3, 0.4]), "radii": lambda: 0.01,
    "spread": lambda: 0.1, "materials": lambda: ["steel 316", "PTFE"], "snapshots": histories,
    "shape": lambda: (FRAMES, SITES),
    "fine": lambda: np.eye(4), "half": lambda: np.eye(4), "factors": lambda: [np.eye(4), np.eye(4)],
    "coefficients": lambda: [0.1, 0.1], "dtype": lambda: "float32",
    "parts": lambda: [("u", 0, 1.0), ("u", 1, -1.0)], "window": lambda: 0.5,
    "multipliers": lambda: np.ones(4), "error": lambda: np.zeros(4), "expected": lambda: 2, "conserves": lambda: True,
    "bead": lambda: 1, "dt": lambda: 0.1, "sampling": lambda: 4.0, "units": lambda: gx.units.Units(),
    "models": lambda: {"one": (scene, {"stiffness": 1.0})}, "candidates": lambda: {
        "linear": lambda k: gx.OnSite(gx.Linear(k))},
    "weights": lambda: np.ones(5), "modes": lambda: np.eye(5), "kind": lambda: "bright", "like": y,
    "x": lambda: np.ones(3), "step": lambda: np.full(3, 0.1), "label": lambda: "fig1.3", "mode": lambda: 0,
    "index": lambda: 0, "result": run, "velocity": lambda: np.zeros((FRAMES, 2)), "tangents": lambda: gx.State(
        np.zeros((5, 2)), np.zeros((5, 2))), "args": lattice, "e": lambda: np.zeros(4), "r": lambda: 0.5,
    "contacts": lambda: np.array([3, 5]), "branch": None, "edge": None, "sweep": None,
    "mass_ratio": lambda: 0.1 + times() / 2,
    "transmission": times, "made": matplotlib.figure.Figure, "wp": None, "fl": None, "br": None, "breather": None,
    "dispersion_record": None, "run_or_array": run, "parameters": lambda: {"stiffness": 1.0}, "ladders": lambda: [
        Ladder("default", "step", [0.2, 0.1], lambda step: (y(), 1, 1))],
    "reference": y, "problem": None, "cost": lambda: lambda x: x, "both": lambda: lambda x: (x, x), "size": lambda: 1,
    "optimiser": lambda: None, "max_steps": lambda: 3, "tolerance": lambda: 1e-6, "final": y, "vectors": np.zeros,
    "direction": lambda: 1.0,
}
# of one callable: `function.argument`
def gapped(k):
    """Two bands that do not touch."""
    return jnp.array([[1.0, 0.1 * jnp.cos(k[0])], [0.1 * jnp.cos(k[0]), -1.0]]) + 0j


def squares(k):
    """Bands of the quadrupole lattice."""
    x, y = 0.5 + jnp.exp(1j * k[0]), 0.5 + jnp.exp(1j * k[1])
    half = jnp.zeros((4, 4), complex).at[0, 1].set(x).at[2, 3].set(x).at[0, 2].set(y).at[1, 3].set(-y)
    return half + half.conj().T


OWN = {
    **dict.fromkeys((f"scenes.plane.{name}.n" for name in (
        "packing.packing", "lattices.square", "lattices.triangular")), lambda: 3),
    "scenes.plane.packing.packing.radius": lambda: 0.01, "strains.along.Along.direction": lambda: [1.0, 0.0],
    "scenes.plane.networks.junction.branches": lambda: [3, 3], "scenes.plane.networks.junction.stem": lambda: 3,
    "scenes.plane.networks.network.nodes": lambda: [[0.0, 0.0], [3.0, 0.0], [6.0, 1.0]],
    "scenes.plane.networks.network.edges": lambda: [(0, 1), (1, 2)], "scenes.plane.networks.network.beads": lambda: 3,
    "linear.gauge.smooth_gauge.vectors": lambda: np.ones((4, 1, 1)),
    **dict.fromkeys((f"topology.{name}.lattice" for name in (
        "berry_curvature", "chern", "polarisation", "valley_chern")),
                    lambda: gapped),
    "topology.quadrupole.lattice": lambda: squares,
    "topology.winding.lattice": lambda: gx.scenes.ssh(5, boundary="periodic"),
    "linear.ribbon.ribbon.lattice": lambda: gx.scenes.square(5, 3, boundary=("periodic", "fixed")),
    "linear.zone.zone_map.lattice": lambda: gx.scenes.square(5, boundary="periodic"),
    "measures.rings.front_decay.lattice": lambda: gx.scenes.hexagon(6),
    "measures.rings.front_decay.amplitude": lambda: np.ones(127), "measures.rings.front_decay.site": lambda: 63,
    "measures.rings.radial_profile.lattice": lambda: gx.scenes.hexagon(6),
    "measures.rings.radial_profile.quantity": lambda: np.ones(127),
    "measures.rings.energy_radius.lattice": lambda: gx.scenes.square(3),
    "measures.rings.energy_radius.y": lambda: gx.State(np.zeros((3, 3, 2)), np.ones((3, 3, 2))),
    "states.simple.radial_impact.lattice": lambda: gx.scenes.hexagon(2),
    "states.simple.radial_impact.radius": lambda: 1.5, "states.simple.radial_impact.velocity": lambda: 0.5,
    "terms.dissipation.CaputoDamping.order": lambda: 0.5, "terms.long_range.LongRange.kernel": lambda: [1.0, 0.5],
    "states.bloch.bloch_packet.band": lambda: 0,
    "states.bloch.bloch_packet.lattice": lambda: gx.scenes.monomer(8, precompression=1.0, boundary="periodic"),
    "studies.bullet.sound_bullet.channels": lambda: [0, 3], "studies.bullet.sound_bullet.focus": lambda: 2,
    "measures.networks.slip_ratio.lattice": lambda: gx.scenes.triangular(3, precompression=0.2, rotation=True),
    "measures.networks.slip_ratio.y": lambda: gx.State(np.zeros((3, 3, 3)), np.zeros((3, 3, 3))),
    "measures.networks.angular_momentum.lattice": lambda: gx.scenes.square(3),
    "measures.networks.angular_momentum.y": lambda: gx.State(np.zeros((3, 3, 2)), np.zeros((3, 3, 2))),
    "measures.networks.force_network.lattice": lambda: gx.scenes.junction(3, (2,)),
    "theory.relaxation.mittag_leffler.z": lambda: -1.0,
    "sweeps.sweep.sweep.parameters": lambda: {"x": [1.0, 2.0]}, "sweeps.sweep.sweep.units": lambda: {"x": "m"},
    "sweeps.sweep.sweep.function": lambda: lambda x: x, "sweeps.points.paired.parameters": lambda: {"x": [1.0, 2.0]},
    "sweeps.points.random.bounds": lambda: {"x": (0.0, 1.0)}, "sweeps.sweep.read.store": lambda: kept(),
    "scenes.resonators.woodpile.masses": lambda: [0.5], "scenes.resonators.woodpile.stiffnesses": lambda: [1.0],
    "scenes.modulated.travelling_modulation.sites": lambda: 6,
    "laws.plastic.Indented.law": lambda: gx.Thornton(1.0, 0.1), "flow.memory.caputo.caputo.order": lambda: 0.5,
    "flow.memory.caputo.caputo.field": lambda: lambda t, y, args: y,
    "terms.plastic.PlasticContact.law": lambda: gx.Thornton(1.0, 0.1),
    "studies.spreading.spreading.scene": lambda: lambda seed: gx.scenes.disordered(200, 0.3, seed),
    "scenes.chains.pattern.masses": lambda: [1.0, 0.5], "scenes.chains.defects.masses": lambda: {2: 0.5},
    "orbits.guesses.sites.single_site.sites": lambda: [2], "orbits.forced_branch.forced_branch.start": lambda: 0.8,
    "first_order.equations.field.psi": lambda: np.ones(SITES) + 1j,
    "first_order.equations.DpS.state.psi": lambda: np.ones(SITES) + 1j,
    "first_order.evolution.evolve.psi": lambda: np.ones(SITES),
    "first_order.solitons.soliton.omega": lambda: -1.0, "first_order.solitons.soliton.guess": lambda: "site",
    "first_order.trapping.self_trapping.scene": lambda: lambda chi: gx.first_order.DNLS(SITES, 1.0, chi),
    "first_order.trapping.self_trapping.low": lambda: 1.0, "first_order.trapping.self_trapping.high": lambda: 9.0,
    **{f"kinks.{name}.{argument}": make for name in ("kink", "peierls_nabarro", "moving") for argument, make in (
        ("lattice", lambda: gx.scenes.sine_gordon(30, 0.5)), ("right", lambda: 2 * np.pi), ("left", lambda: 0.0))},
    "kinks.kink.centre": lambda: 14.5, "kinks.moving.velocity": lambda: 0.1, "kinks.moving.centre": lambda: 14.5,
    "orbits.anticontinuous.anticontinuous.scene": lambda: lambda c: gx.scenes.klein_gordon(SITES, c),
    "orbits.anticontinuous.anticontinuous.coupling": lambda: 0.05,
    "orbits.anticontinuous.anticontinuous.omega": lambda: 1.5, "orbits.anticontinuous.anticontinuous.sites": lambda: 2,
    "orbits.forced_branch.forced_branch.until": lambda: 0.9, "identify.wall.wall_modulus.start": lambda: 1e9,
    "flow.derivative.derivative.function": lambda: lambda x, step: x,
    "flow.derivative.derivative.step": lambda: 0.1, "flow.derivative.derivative.x": lambda: 1.0,
    "identify.pinn.physics_informed.sites": lambda: [1, 2], "materials.Material.name": lambda: "glass",
    "canonical.scenes.scene.name": lambda: gx.canonical.names()[0], "plots.curves.profile.y": times,
    "plots.curves.profile.x": times,
    "plots.style.save.path": lambda: "file.png", "plots.style.drawn.ending": lambda: ".png",
    "plots.fits.fit.result": fitted, "plots.fits.corner.result": fitted, "plots.fits.law.strain": times,
    "plots.fits.law.force": times, "plots.histories.traces.ts": run,
    "lattice.model.Lattice.units": lambda: "SI", "lattice.model.Lattice.counted_in.units": lambda: "SI",
    "measures.spectra.spectrum.units": lambda: "SI", "measures.spectra.spectrogram.units": lambda: "SI",
    "materials.named.argument": lambda: "name", "materials.Material.poisson": lambda: 0.3,
    "lattice.model.Lattice.mass": lambda: np.ones(SITES),
    "laws.base.Sum.parts": lambda: [gx.Hertz(), gx.Linear(1.0)], "laws.spline.Spline.stiffness": lambda: np.ones(4),
    "measures.modal.modal_energy.omega": lambda: np.ones(5), "studies.resonance.decay.anti_resonance.low": lambda: 0.3,
    "studies.gates.switch.signal": lambda: (1e-3, 1.7), "studies.gates.switch.amplitudes": lambda: [1e-3, 2e-3],
    "studies.gates.TruthTable.thresholds.gate": lambda: "AND",
    "studies.resonance.maps.resonance_map.kind": lambda: "2:1",
    "studies.resonance.maps.resonance_map.first": lambda: [0.5],
    "identify.pinn.physics_informed.velocity": histories, "plots.fits.law.low": lambda: np.zeros(FRAMES),
    "plots.fits.law.high": lambda: np.ones(FRAMES),
    "identify.wall.wall_modulus.lattice": lambda: gx.scenes.monomer(SITES, boundary="free"),
    "identify.regression.regression.mass": lambda: np.ones(SITES),
    "theory.nls.bright_profile.coefficients": envelope, "theory.nls.dark_profile.coefficients": lambda: envelope(-1.0),
    "theory.nls.bright_profile.omega": lambda: 1.1, "theory.nls.dark_profile.omega": lambda: 1.1,
    "orbits.guesses.envelope.supports_bright.edge": lambda: Edge(0.0, 0, 1.0, True, envelope()),
    "orbits.symmetry.Symmetry.matrix.like": y, "results.Result.save.path": lambda: "file.nc",
    "theory.nls.dark.nu2": lambda: -1.0, "theory.elliptic.jacobi.u": lambda: 0.7,
    "travelling.long_wave.long_wave.strain": lambda: np.ones(8),
    "travelling.periodic.periodic_wave.wavelength": lambda: 8.0,
    "travelling.cells.public.tail_free.low": lambda: 0.1,
    "travelling.cells.public.tail_free.cell": lambda: lambda ratio: (gx.Hertz(), [1.0, ratio]),
    "studies.resonance.maps.resonance_map.second": lambda: np.array([1.0, 1.1]),
    **{f"studies.resonance.oscillations.squeeze_count.{x}": lambda: np.array([0.0, 1.0, 1.0, 0.0])
       for x in ("left", "right")},
    **{f"states.solitons.{name}_soliton.lattice": lambda: gx.scenes.monomer(40, precompression=0.3, boundary="free")
       for name in ("toda", "kdv")},
    **{f"theory.{name}": (lambda x=x: x) for name, x in {
        "long_wave.omega_squared.form": "strain", "long_wave.residual.form": "strain",
        "long_wave.travelling_residual.form": "strain", "long_wave.residual.y": np.ones(8),
        "long_wave.residual.y_tt": np.ones(8), "long_wave.residual.force": np.square,
        "long_wave.travelling_residual.profile": jnp.cos, "long_wave.travelling_residual.force": jnp.square,
        "fitting.shock_edges.c": 0.1, "simple_wave.mean.c": 0.1, "simple_wave.fan.c": -0.1,
        **{f"linear_shock.{name}_step.n": 2 for name in ("velocity", "strain")},
        "toda.two_solitons.k2": 0.5, "toda.phase_shifts.k2": 0.5,
        **{f"toda_periodic.{name}.E{i}": E for name in ("periodic_wave", "periodic_numbers")
           for i, E in enumerate((-1.0, 0.2, 0.6, 1.0), 1)},
        "toda_periodic.lax_eigenvalues.strain": np.zeros(2),
        "toda_periodic.lax_eigenvalues.velocity": np.zeros(3), "kdv.amplitude.speed": 1.5, "kdv.cnoidal.r1": 0.0,
        "kdv.cnoidal.r2": 0.01, "kdv.cnoidal.r3": 0.02,
        **{f"toda_shock.{name}.c": 0.5 for name in ("velocity_shock", "modulation", "modulus", "shock_wave")},
        **{f"kdv_shock.{name}.c": 0.1 for name in ("velocity_shock", "modulation", "modulus", "shock_wave")},
        "kdv_shock.modulation.m": 0.5, "kdv_shock.shock_wave.t": 10.0,
        "toda_shock.modulation.m": 0.5, "toda_shock.shock_wave.t": 10.0,
        **{f"compacton.{kind}.p": 1.5 for kind in ("nesterenko", "ahnert_pikovsky")},
    }.items()},
    "newton.newton.guess": lambda: np.ones(1),
    "shocks.scenes.step.left": lambda: 0.2, "shocks.scenes.step.right": lambda: 0.1,
    "shocks.scenes.step.centre": lambda: 2, "shocks.balances.balances.problem": shock,
    "shocks.balances.balances.box": lambda: (1, 3), "shocks.history.space_time.problem": shock,
    "terms.base.Term.force.mass": lambda: 1.0,
    "lattice.model.Lattice.total.parts": lambda: [np.zeros(5)],
    "fit.files.read_csv.path": lambda: file("file.csv"),
    "states.stored.stored.data": frames, "exchange.datasets.save.data": frames,
    "exchange.datasets.save.path": lambda: file("new.nc"),
    "exchange.datasets.load.path": lambda: file("saved.nc"), "exchange.datasets.arrays.path": lambda: file("file.mat"),
    "fit.files.read_arrays.path": lambda: file("file.mat"),
    "identify.law.law.scene": lambda: lambda law, others=None: gx.Lattice(
        np.ones(SITES), gx.Bond(gx.Shift(1, "fixed"), law)),
    "lattice.tangents.variational.y": lambda: tuple((np.zeros(SITES), np.zeros((SITES, 2))) for _ in "uv"),
    "continuation.trace.continuation.x0": lambda: 1.0, "continuation.trace.continuation.p0": lambda: 0.0,
}


# given beside the argument that is replaced, by the callable and the argument; "" for every other
ALSO = {
    "fit.files.read_csv": {"": {"velocity": 1, "sites": 2}, "displacement": {"sites": 2}, "force": {"contacts": 2}},
    "fit.files.read_arrays": {"": {"velocity": "v", "time": "t", "sites": 2}, "displacement": {"time": "t", "sites": 2},
                           "force": {"time": "t", "contacts": 2}},
    "fit.traces.Traces": {"": {"velocity": np.zeros((FRAMES, 2)), "sites": [1, 2]}, "displacement": {"sites": [1, 2]},
                          "force": {"contacts": [1, 2]}, "contacts": {"force": np.zeros((FRAMES, 2))}},
    "identify.law.law": {"": {"stiffness": 1.0}},
    "states.solitons.toda_soliton": {"": {"k": 1.0}, "k": {}, "speed": {}, "amplitude": {}},
    "states.solitons.kdv_soliton": {"": {"amplitude": 0.3}, "speed": {}, "amplitude": {}},
    "shocks.fronts.dissipative_front": {"": {"behind": 1.0}, "behind": {}, "piston": {}},
    "theory.kdv.soliton": {"": {"amplitude": 0.1}, "amplitude": {}, "speed": {}},
    "theory.toda.wavenumber": {"": {"speed": 1.5}, "speed": {}, "amplitude": {}, "energy": {}},
    "travelling.solitary.solitary_wave": {"": {"speed": 1.2}, "speed": {}, "amplitude": {}, "energy": {}},
    "states.waves.solitary_wave": {"": {"speed": 1.2}, "speed": {}, "amplitude": {}, "energy": {}},
    "travelling.family.family": {"": {"speed": np.array([1.2, 1.3])}, "speed": {}, "amplitude": {}, "energy": {}},
    "travelling.periodic.periodic_wave": {"": {"amplitude": 0.1}, "speed": {}, "amplitude": {}},
    "travelling.cells.public.cell_wave": {"": {"masses": [1.0, 0.5], "speed": 1.2}, "masses": {}, "speed": {}},
    **{f"theory.elliptic.{name}": {"": {"m": 0.5}, "m": {}, "m1": {}}
       for name in ("jacobi", "zeta", "K", "E", "Pi", "F", "incomplete_E", "incomplete_Pi")},
}


def blank(cls):
    """An instance without contents: enough where what is wrong is refused before it is read."""
    return cls(*[None] * len(cls._fields)) if issubclass(cls, tuple) else object.__new__(cls)


def valid(target, p):
    """A valid value of a parameter, and whether it has contents."""
    make = OWN.get(f"{target.key}.{p.name}") or VALID.get(p.name)
    if make is not None:
        found = make()
        if admits(p.annotation, found):
            return found, True
    hint = p.annotation
    for one in (hint, *typing.get_args(hint)):
        if one in (float, int):
            return one(1), True
        if inspect.isclass(one) and one.__module__.startswith("granjax"):
            return blank(one), False
        if one in (str, abc.Callable) or typing.get_origin(one) is abc.Callable:
            return ("text" if one is str else lambda *x: x[0]), True
    if beartype.door.is_bearable(np.ones(3), hint):
        return np.ones(3), hint is not typing.Any
    raise LookupError(f"{target.key}({p.name}: {hint}) has no valid value in the table")


# callables whose valid arguments take a computation to make: they are given what is wrong alone
BLANK = (
    "canonical.scenes.Scene.error", "fit.fitted.Fit.whiteness", "fit.solve.linearised",
    "identify.dmd.DynamicModes.reconstruction", "identify.law.ForceLaw.band", "identify.law.ForceLaw.force",
    "identify.pinn.Motion.state", "identify.planar.planar_ode", "linear.cell.UnitCell.displacements",
    "linear.cell.UnitCell.dynamical_matrix",
    "linear.cell.UnitCell.slopes", "orbits.bifurcations.bifurcations", "orbits.branch.Branch.orbit",
    "orbits.localised.Localisation.why_not", "orbits.orbit.Orbit.harmonics", "orbits.orbit.Orbit.run",
    "plots.cells.cell_wave", "plots.cells.resonance_map",
    "plots.orbits.branch", "plots.orbits.breather", "plots.orbits.floquet_circle", "plots.orbits.hysteresis",
    "plots.precision.work_precision", "plots.shocks.modulation", "plots.shocks.shock", "plots.shocks.shock_core",
    "plots.shocks.shock_map", "plots.spreading.spreading", "plots.sweeps.sweep",
    "plots.devices.rectifier", "plots.devices.switch", "plots.devices.truth_table", "plots.devices.two_way",
    "plots.evolutions.evolution", "plots.evolutions.gap_breather", "plots.rest.equilibrium", "plots.rest.kink",
    "plots.plane.bands", "plots.plane.beads", "plots.plane.zone", "plots.plane.radial_profile",
    "plots.devices.sound_bullet", "sweeps.table.table", "shocks.fronts.dissipative_front",
    "studies.spreading.Spreading.within", "orbits.backbone.Backbone.omega_at", "linear.flat.FlatBands.state",
    "orbits.backbone.Backbone.state",
    "plots.waves.dispersion", "plots.waves.floquet_bands",
    "linear.floquet_bands.FloquetBands.state", "studies.resonance.finite.refine",
    "studies.gates.TruthTable.table", "studies.gates.TruthTable.thresholds",
    "plots.travelling.reflection", "plots.travelling.wave", "plots.travelling.wave_errors",
    "identify.planar.PlanarODE.bend", "identify.planar.PlanarODE.periodic", "identify.planar_orbits.PlanarOrbit.strain",
    "plots.fits.planar", "plots.travelling.front", "plots.travelling.wave_family", "shocks.measure.measure",
    "theory.stokes.StokesWave.strain",
    *(f"shocks.front.DissipativeFront.{name}" for name in ("strain", "velocity", "displacement", "state")),
    "travelling.collisions.collide", "travelling.reflection.reflect", "travelling.stability.ring",
    "travelling.long_wave.LongWave.unresolved", "travelling.stability.stability", "travelling.wave.Wave.floquet",
    *(f"travelling.{kind}.{name}" for kind in ("cells.public.CellWave", "periodic.PeriodicWave", "wave.Wave")
      for name in ("strain", "velocity", "displacement", "state")),
    "work_precision.table.WorkPrecision.advice", "work_precision.table.WorkPrecision.to_json",
)
INSTANCES = {
    gx.Lattice: lattice, gx.Flow: lambda: gx.Flow(8), gx.units.Units: gx.units.Units, gx.Traces: traces,
    gx.Resonator: lambda: gx.Resonator(0.1, 1.0),
    gx.orbits.Symmetry: gx.orbits.Symmetry, gx.shocks.Riemann: shock, Result: run, Figure: lambda: figure("fig1.3"),
}


def instance(cls):
    make = INSTANCES.get(cls)
    return (make(), True) if make else (blank(cls), False)


# ------------------------------------------------------------------------------------------------------------- a trial


class Computing(BaseException):
    """The call came as far as computing: what it was given was accepted."""


class Late(BaseException):
    """The call took longer than a refusal may."""


_watching, _small, COMPILED = [], [], []
# of JAX's own functions those that hold a program
LARGE = ("scan", "while", "cond", "while_loop", "fori_loop", "map")
# so many small ones, one after another, are a computation too
MOST_SMALL = 8


def small(program):
    """Whether a program is one function of JAX's own, such as a conversion: what looks at an argument needs those."""
    name = re.sub(r"^jit[_(]", "", program).rstrip(")").lstrip("_")
    return name not in LARGE and (hasattr(jnp, name) or hasattr(jax.lax, name) or hasattr(jax.lax, f"{name}_p"))


def _event(name, *_, fun_name="", **__):
    if not _watching:
        return
    if name == "/jax/core/compile/jaxpr_to_mlir_module_duration":
        _small.append(fun_name)
        if len(_small) > MOST_SMALL or not small(fun_name):
            raise Computing
    if name == "/jax/core/compile/backend_compile_duration" and not small(fun_name):
        COMPILED.append(_watching[-1])


jax.monitoring.register_event_duration_secs_listener(_event)


@contextmanager
def watched(name, seconds=3.0):
    """Nothing of size is compiled inside, nothing takes the processor long: that raises `Computing` or `Late`."""
    def late(*_):
        raise Late

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    _watching.append(name)
    _small.clear()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        _watching.pop()


HOUSE = re.compile(r"(?s)^(?P<argument>.+?): expected .+, got .+")


class Case(NamedTuple):
    """One public callable with one argument replaced."""

    target: Target
    argument: str
    value: str

    def __str__(self):
        return f"{self.target.key}({self.argument}={self.value})"


def cases(target):
    # a list that holds itself ends inside of Equinox, which looks into what a module is made of
    module = inspect.isclass(target.function) and issubclass(target.function, eqx.Module)
    values = [value for value in (*VALUES, *TRACED) if not (module and value == "endless")]
    return [Case(target, name, value) for name in target.arguments() for value in values]


class Outcome(NamedTuple):
    """sentence, raw, accepted or late, whether the value must be refused, and the error."""

    kind: str
    must: bool
    told: str
    good: bool


def call(case, x):
    target, full = case.target, True
    also = ALSO.get(target.key, {"": {}})
    keywords = dict(also.get(case.argument, also[""]))
    for name, p in target.arguments().items():
        if name == case.argument:
            keywords[name] = x
        elif p.default is p.empty and name not in keywords:
            keywords[name], contents = valid(target, p)
            full = full and contents
    positional = [keywords.pop(p.name) for p in target.arguments().values()
                  if p.kind is p.POSITIONAL_ONLY and p.name in keywords]
    if target.cls is not None and not isinstance(inspect.getattr_static(target.cls, target.name.split(".")[-1]),
                                                 (staticmethod, classmethod)):
        own, contents = instance(target.cls)
        positional, full = [own, *positional], full and contents
    return (lambda: target.function(*positional, **keywords)), full


def names(case, text):
    """Whether a sentence names the argument, as it is written or spoken; of a traced value, that it is one."""
    spoken = re.sub("_", "[_ ]", case.argument.rstrip("s"))
    traced = case.value in TRACED and re.search("trac|transformation", text)
    return traced or re.search(rf"\b{spoken}", text)


def trial(case):
    """What becomes of a case; `None` where it says nothing: a valid kind, and a call that has no contents.

    Where the argument is "" none is replaced.
    """
    given = case.target.arguments().get(case.argument)
    must, full = True, True

    def of(x):
        nonlocal must, full
        must = given is not None and x is not given.default and not admits(given.annotation, x)
        run, full = call(case, x)
        if must or full:
            with watched(str(case)):
                run()

    def traced(x):
        of(x)
        return 0.0

    kind, told = "accepted", ""
    try:
        with typed.off():
            if case.value in TRACED:
                jax.eval_shape(traced, TRACED[case.value])
            else:
                of(VALUES[case.value]())
    except Computing:
        pass
    except Late:
        kind = "late"
    except (ValueError, TypeError) as error:
        told = f"{type(error).__name__}: {error}"
        found = HOUSE.match(str(error))
        named = found is not None and names(case, found["argument"] if must else told)
        kind = "sentence" if named else "raw"
    except BaseException as error:
        kind, told = "raw", f"{type(error).__name__}: {error}"
    if not must and not full:
        return None
    return Outcome(kind, must, told, kind == "sentence" or kind == "accepted" and not must)


def chosen(all_cases, number, seed=0):
    """A seeded choice of so many, with cases of every argument of every callable.

    Each is drawn by its own name: another callable or argument leaves the others' cases as they are.
    """
    by, turn = {}, {case: random.Random(f"{seed} {case}").random() for case in all_cases}
    for case in all_cases:
        by.setdefault((case.target.key, case.argument), []).append(case)
    for group in by.values():
        group.sort(key=turn.get)
    each = number // len(by)
    rest = sorted((case for group in by.values() for case in group[each:]), key=turn.get)
    return [case for group in by.values() for case in group[:each]] + rest[: number - each * len(by)]
