"""How a sweep is gone about: compiled or not, in what order, in which chunks."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import refuse
from ..flow.lifted import Asked, ErrorsRead, asking, quietly, scene_of
from ..flow.method import checked_method, fixed_step, useless
from ..outside import Outside
from ..programs import wait
from . import function as called
from .identity import array_digest
from .points import Points
from .task import EACH, LANES, VMAP, How, Task, groups, program

# numbers of all sites and lanes of a chunk, and its lanes: those whose arrays stay in a core's own cache
CACHED, LEAST, MOST = 2**17, 8, 64
# lanes of a chunk that no run takes long of; chunks of what is called lane by lane
PLAIN, CHUNKS = 4096, 1024
# costs that differ by less are alike; lanes whose costs are found at a time; most lanes that are looked at one by one
ALIKE, ABREAST, LOOKED = 1.05, 256, 4096


class Plan(NamedTuple):
    """How lanes are computed, so many at a time, in which order, `None` for that of the design; a first scene."""

    how: How
    chunk: int
    order: np.ndarray | None
    scene: str = ""


def planned(function: Callable, points: Points, lanes: bool | None, chunk: int | None) -> Plan:
    """The plan of a sweep. **Raises** what the function raises where it is of no use for any lane."""
    names = tuple(points.axes)
    keywords = called.by_keywords(function, names)
    how = How(EACH) if lanes is False else _how(function, points, min(chunk or 2, points.count))
    values = points.values(np.arange(points.count))
    if how.kind == EACH:
        return Plan(how, chunk or max(1, -(-points.count // CHUNKS)), None)
    # what no program of many lanes would notice
    alone = np.zeros(points.count, bool)
    alone[_refused(function, keywords, points)] = True
    if alone.all():
        return Plan(How(EACH), chunk or max(1, -(-points.count // CHUNKS)), None)
    costs, sites, scene = _costs(function, keywords, how, values, np.flatnonzero(~alone), points.count)
    if sites:
        # and what none could do
        alone |= ~np.isfinite(costs) | useless_count(costs)
    how = how._replace(apart=tuple(map(int, np.flatnonzero(alone))))
    if not sites:
        order = np.argsort(alone, kind="stable") if alone.any() else None
        return Plan(how, chunk or min(PLAIN, points.count), order)
    known = costs[~alone]
    varied = known.size and known.max() > ALIKE * known.min()
    order = np.argsort(np.where(alone, np.inf, -costs), kind="stable") if varied or alone.any() else None
    return Plan(how, chunk or _chunk(sites, points.count), order, scene)


def plan_of(identity: dict) -> Plan:
    """The plan that a store was begun with."""
    how, order = identity["how"], identity["order"]
    how = How(how["kind"], tuple(how["static"]), how["errors"], tuple(how["apart"]), tuple(how["shared"]))
    return Plan(how, identity["chunk"], None if order is None else np.array(order, int))


def parts_of(points: Points, plan: Plan) -> list[np.ndarray]:
    """Numbers of the lanes of each chunk: such as share a program."""
    order = np.arange(points.count) if plan.order is None else plan.order
    alone = np.zeros(points.count, bool)
    alone[list(plan.how.apart)] = True
    values, parts = points.values(np.arange(points.count)), []
    for group in groups(values, plan.how.static, order[~alone[order]]):
        parts += [group[i : i + plan.chunk] for i in range(0, len(group), plan.chunk)]
    return parts + [np.array([lane]) for lane in order[alone[order]]]


def _chunk(sites, count):
    least = LEAST if sites * LEAST <= CACHED else 1
    return int(min(np.clip(CACHED // max(sites, 1), least, MOST), -(-count // LEAST) * LEAST))


def _how(function, points, width):
    """Compiled with lanes last where that can be, by `jax.vmap` where only that can, else called for each lane."""
    kinds = {name: x.dtype.kind for name, x in points.axes.items()}
    words = tuple(name for name, kind in kinds.items() if kind in "Ub")
    whole = tuple(name for name, kind in kinds.items() if kind in "iuUb")
    shared = _shared(points)
    for static in dict.fromkeys((words, whole)):
        for kind in (LANES, VMAP):
            for errors in (False, True):
                found = _fits(function, points, How(kind, static, errors, (), shared), width)
                if found is not ErrorsRead:
                    break
            if found is None:
                return How(kind, static, errors, (), shared)
    return How(EACH)


def _shared(points):
    """Names of the numbers that all lanes have in common, beside others that they have not."""
    same = [name for name, x in points.axes.items() if x.dtype.kind == "f" and (x == x[0]).all()]
    return tuple(same) if len(same) < len(points.axes) else ()


def _fits(function, points, how, width):
    """`None` where a program of so many lanes can be made of a function, else why not.

    **Raises** ValueError where the program would be another one each time.
    """
    # as wide as a chunk that is asked for: then it is traced once
    task = Task(function, tuple(points.axes), how, width)
    values = points.values(np.zeros(width, int))
    shapes = {name: jax.ShapeDtypeStruct(() if name in how.shared else x.shape, x.dtype)
              for name, x in values.items() if name not in how.static}
    if not any(x.shape for x in shapes.values()):
        return ValueError
    known = task.known(values)
    try:
        program.eval_shape(known, Outside((function,)), shapes)
    except ErrorsRead:
        return ErrorsRead
    except Exception as error:
        # whatever it is: the function is called lane by lane then, and says it where it stands
        return type(error)
    _refuse_draws(known, tuple(shapes.items()))
    return None


# of as many functions it is known that they compute the same each time
@lru_cache(maxsize=64)
def _refuse_draws(known, shapes):
    given = Outside((known.function,)), dict(shapes)
    # as another function, or JAX would not trace it again
    again = jax.jit(lambda *given: program.__wrapped__(known, *given)).trace(*given)
    if _numbers(program.trace(known, *given)) != _numbers(again):
        remedy = (
            "It is compiled once for many lanes, which would share what NumPy or Python's random "
            "draws. Draw from a parameter instead: jax.random.normal(jax.random.key(seed), shape), "
            "with one seed for each lane. Or give lanes=False, which calls it for every lane."
        )
        got = "one with other numbers when it is called again"
        refuse("function", "one that computes the same each time", got, remedy)


def _numbers(traced):
    """What is known of numbers in a traced program, and of what it returns that is no array."""
    return [*_constants(traced.jaxpr), *_constants(jax.tree.leaves(traced.out_info[1].value))]


def _constants(x):
    """What is known of numbers in a traced program and in the programs within it, in order."""
    if isinstance(x, (tuple, list)):
        for part in x:
            yield from _constants(part)
    elif hasattr(x, "consts"):
        yield from _constants([*x.consts, x.jaxpr])
    elif hasattr(x, "eqns"):
        for equation in x.eqns:
            yield equation.primitive.name
            yield from _constants([*equation.invars, *equation.params.values()])
    elif hasattr(x, "val"):
        yield from _constants([x.val])
    elif isinstance(x, (str, int, float, complex, np.generic, np.ndarray, jax.Array)):
        yield array_digest(x)


@partial(jax.jit, static_argnums=0)
def _steps(known, outside, values):
    """About how many steps of a lattice's own the first run of each lane takes."""

    def one(values):
        try:
            with asking():
                called.call(known.function, {**dict(known.static), **values}, known.keywords)
        except Asked as asked:
            with quietly():
                return _steps_of(*asked.scene)
        return jnp.nan

    return jax.vmap(one)(values)


def _steps_of(lattice, state, t1, keywords):
    solver, step, tolerance = checked_method(lattice, *(keywords[name] for name in ("solver", "step", "tolerance")))
    t0 = keywords["t0"]
    if tolerance is None and step is not None:
        return (t1 - t0) / jnp.asarray(step)
    steps = (t1 - t0) / jnp.asarray(fixed_step(lattice, state, t0, t1, None, solver, 1)[0])
    # adaptive steps need no bound
    return steps if tolerance is None else jnp.clip(jnp.nan_to_num(steps, nan=1.0), 1.0, 1e6)


def _costs(function, keywords, how, values, lanes, count):
    """Steps of each lane (n,), NaN for all but `lanes`; sites of the largest scene, 0 where nothing runs; a scene."""
    task, costs, sites, text = Task(function, tuple(values), how, ABREAST), np.full(count, np.nan), 0, ""
    for lanes in groups(values, how.static, lanes):
        scene = _scene(function, {name: x[lanes[0]].item() for name, x in values.items()}, keywords)
        if scene is not None:
            sites = max(sites, sum(x.size for x in jax.tree.leaves(scene[1][0])))
            text = text or repr(scene[0])
        for i in range(0, len(lanes), ABREAST):
            some = lanes[i : i + ABREAST]
            here = {name: x[np.resize(some, ABREAST)] for name, x in values.items()}
            arrays = {name: x for name, x in here.items() if name not in how.static}
            try:
                found = wait(_steps(task.known(here), Outside((function,)), arrays))
            except Exception:
                # no cost is known: then lanes are taken as they come
                found = np.full(ABREAST, 1.0 if scene is not None else np.nan)
            costs[some] = np.asarray(found)[: len(some)]
    return costs, sites, text


def _scene(function, values, keywords):
    """What a lane runs, `None` where it runs nothing or is refused."""
    try:
        return scene_of(called.call, function, values, keywords)
    except Exception:
        return None


def useless_count(steps: np.ndarray) -> np.ndarray:
    """Whether so many steps are of no use."""
    return np.array([useless(1.0 / n, 0.0, 1.0) if np.isfinite(n) and n > 0 else True for n in steps])


def _refused(function, keywords, points):
    """Numbers of lanes whose scenes are refused, which a compiled program does not notice.

    What is refused is looked for at the ends of each parameter first; where one of these is, at every lane, or of many
    at every value of each parameter beside those of a lane that is not.
    """
    values = points.values(np.arange(points.count))
    ends = {int(f(x)) for x in values.values() if x.dtype.kind != "U" for f in (np.argmin, np.argmax)} | {0}
    refused = {lane: _is_refused(function, keywords, points.at(lane)) for lane in sorted(ends)}
    if not any(refused.values()):
        return np.zeros(0, int)
    if points.count <= LOOKED or all(refused.values()):
        return np.array([n for n in range(points.count) if _is_refused(function, keywords, points.at(n))], int)
    good = points.at(next(lane for lane, bad in refused.items() if not bad))
    bad = np.zeros(points.count, bool)
    for name, x in values.items():
        known, which = np.unique(x, return_inverse=True)
        of_value = [_is_refused(function, keywords, {**good, name: one.item()}) for one in known]
        bad |= np.array(of_value)[which]
    return np.flatnonzero(bad)


def _is_refused(function, keywords, values):
    try:
        scene_of(called.call, function, values, keywords)
    except Exception:
        return True
    return False
