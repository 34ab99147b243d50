"""Identify the terms of a lattice from data, by sparse regression on a library of terms.

`regression` finds which terms act, and how strongly, from the motion of all sites. `library` gives
candidate terms. `granjax.fit` finds parameters of a known law or coefficients of a `Spline`.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ..base.checks import non_negative, one_of, parameter, positive, refuse, within
from ..base.printing import told
from ..base.programs import compiled
from ..base.types import Count, Displacements, Parameter, Scalar, Times
from ..lattice import Lattice
from ..laws import Polynomial, PowerLaw, Scaled
from ..results import Result, array
from ..strains import StrainMap
from ..terms import Bond, Damping, Dashpot, Drag, OnSite, Term, ViscousContact
from .determined import covariance, directions
from .judge import neighbours, structure

# The outcome calls coefficients interchangeable above this condition number of the scaled columns.
ALIKE = 1e6
# A residue below this many differentiation errors is ignored.
MARGIN = 1.5
# A residue below this many rounding errors is ignored as well.
ROUNDING = 1e6
# the most samples among which neighbours are searched, which takes a fraction of a second
MOST = 10_000


class Coefficient(NamedTuple):
    """A coefficient, its standard error, and its share of the rms acceleration."""

    value: float
    error: float
    share: float
    __repr__ = told


class Regression(Result):
    """The result of `regression`."""

    coefficients: dict[str, Coefficient] = array(
        "`Coefficient(value, error, share)` of each kept term, by name."
    )
    dropped: tuple[str, ...] = array("The dropped terms.", axes="dropped")
    names: tuple[str, ...] = array("The kept terms.", axes="term", name="term", static=True)
    covariance: Float[np.ndarray, "term term_"] = array(
        "The covariance of the coefficients, ordered as `names`."
    )
    r_squared: float = array("1 - |residual|^2/|a - mean|^2.")
    noise: float = array("The rms of the residual, per degree of freedom.", "m/s^2")
    condition: float = array(
        "The condition number of the kept columns at unit length; large if they are nearly "
        "dependent."
    )
    lattice: Lattice | None = array(
        "The `Lattice` of the found and the known terms; `None` if a term refuses the sign of "
        "its coefficient."
    )
    refused: tuple[str, ...] = array(
        "The names of the terms that refuse the sign of their coefficient.", axes="refused"
    )
    residue: float = array(
        "The rms that neighbouring residuals share beyond noise, over that of the accelerations."
    )

    @property
    def outcome(self) -> str:
        """Sentences on the terms that were kept, and on what is missing."""
        found = self.names
        said = [
            f"{len(found)} of {len(found) + len(self.dropped)} terms kept ({', '.join(found)}); "
            f"R^2 = {self.r_squared:.6g}."
        ]
        if self.residue:
            said.append(
                f"A residue beyond noise is left, {100 * self.residue:.2g} % of the accelerations: neighbours share "
                "it, as independent errors would not. A term is missing among the candidates, or lies below the "
                "threshold; the errors of the coefficients are too small."
            )
        if self.condition > ALIKE:
            said.append(
                f"They are much alike (condition {self.condition:.1g}): their coefficients stand for each other."
            )
        if self.refused:
            said.append(
                f"The sign found for {', '.join(self.refused)} is one that the term refuses."
            )
        return " ".join(said)


def library(
    strain_map: StrainMap,
    *,
    powers: Sequence[Count] = (1, 2, 3),
    contacts: Sequence[Scalar] = (1.5,),
    overlap: Scalar = 0.0,
    on_site: Sequence[Count] = (1, 3),
    dissipation: Sequence[str] | None = None,
) -> dict[str, Callable]:
    r"""Return candidate terms, as a dict from names to functions of a coefficient.

    Bonds K e^p ("e", "e^2", "e^3") and contacts A ([d0 + e]_+^p - d0^p) ("[e]_+^1.5"); on-site forces -k u^p
    ("u", "u^3"); dissipation: "v" (Damping: a = -gamma v), "de/dt" (Dashpot), "[e]_+^0.5 de/dt" (ViscousContact) and
    "v|v|" (Drag).

    **Arguments:**

    - `strain_map`: the bonds, such as `Shift(1, "fixed")`.
    - `powers`, `on_site`: of 1, 2, 3. `contacts`: exponents p > 0.
    - `overlap`: d0 >= 0 of the contacts at equilibrium [m].
    - `dissipation`: names; `None` for all.

    Add your own candidates with `|`: `library(...) | {"wall": lambda A: Wall(Hertz(A))}`. Each term
    must be proportional to its coefficient and accept 1. Offer few: contacts of close exponents,
    and all powers under load, are nearly dependent.
    **Raises** ValueError for another power or name.

    **Example:**

    >>> terms = gx.identify.library(gx.Shift(1, "fixed"), powers=(1, 3), on_site=(), dissipation=["v"])
    >>> list(terms)
    ['e', 'e^3', '[e]_+^1.5', 'v']
    """
    overlap = float(non_negative("overlap", overlap))

    def bond(law):
        return lambda k: Bond(strain_map, _scaled(law, k))

    terms = {_named("e", p): bond(_monomial("powers", p)) for p in powers}
    for p in contacts:
        p = float(positive("contacts", p))
        terms[f"[e]_+^{p:g}"] = bond(PowerLaw(1.0, p, float(np.power(overlap, p))))
    for p in on_site:
        terms[_named("u", p)] = lambda k, law=_monomial("on_site", p): OnSite(_scaled(law, k))
    kinds = {
        "v": Damping,
        "de/dt": lambda c: Dashpot(strain_map, c),
        "[e]_+^0.5 de/dt": lambda c: ViscousContact(strain_map, c, 0.5, overlap),
        "v|v|": Drag,
    }
    for name in kinds if dissipation is None else dissipation:
        terms[name] = kinds[one_of("dissipation", name, kinds)]
    return terms


def _scaled(law, k):
    return Scaled(law, parameter("coefficient", k))


def _named(x, p):
    return x if p == 1 else f"{x}^{p}"


def _monomial(argument, p):
    if p not in (1, 2, 3):
        refuse(argument, "powers 1, 2, 3", repr(p), "Other powers are contacts.")
    return Polynomial(*(1.0 if q == p else 0.0 for q in (1, 2, 3)))


def regression(
    mass: Parameter | dict[str, Parameter],
    candidates: dict[str, Callable[[Any], Any]],
    ts: Times,
    us: Displacements,
    vs: Displacements,
    accelerations: Displacements | None = None,
    *,
    noise: Scalar = 0.0,
    known: Term | Sequence[Term] = (),
    threshold: Scalar = 0.02,
    ridge: Scalar = 0.0,
) -> Regression:
    r"""Find coefficients of the equation of motion a = sum_j c_j f_j(t, u, v)/m from the motion.

    Sequentially thresholded least squares (SINDy): columns f_j/m are scaled to unit length. Those
    whose share of the measured accelerations, |c_j| |f_j/m|/|a|, is below the threshold are
    dropped, and the others solved for again, until none is. The last solution is without ridge.

    Standard errors assume independent, equal errors of the accelerations. They are too small for
    smoothing splines, whose errors are correlated. They omit errors of u and v, which bias
    coefficients towards zero; if these matter, fit trajectories.

    **Arguments:**

    - `mass`: a number, or one per site.
    - `candidates`: dict from names to functions that build a term from its coefficient, as
      `library` returns. Each column is term.force at coefficient 1.
    - `ts` (T,), `us`, `vs` (T, N) or dicts: times, displacements from equilibrium, velocities.
    - `accelerations` (T, N). `None` differentiates a quintic smoothing spline of the velocities at
      each site, with as few knots as leave a residual of rms `noise` [m/s] (Reinsch, Dierckx); 0
      interpolates. It omits three times at each end and needs about twenty samples a period.
    - `known`: terms with known coefficients (walls, drives); their accelerations are subtracted.
    - `threshold`: least share, in [0, 1); typically 0.01 ... 0.1, above the relative noise and
      below the weakest term.
    - `ridge`: added to the diagonal of the scaled normal matrix while terms are selected.

    **Returns:** `Regression`.
    **Raises** ValueError for wrong shapes, fewer numbers than candidates, a candidate without any
    force, or a threshold that drops all.
    Source: Brunton, Proctor, Kutz, PNAS 113, 3932 (2016).

    **Example:**

    >>> terms = gx.identify.library(gx.Shift(1, "fixed"), dissipation=["v"])
    >>> chain = gx.Lattice(1.0, (terms["e"](1.0), terms["e^3"](0.5)), sites=20)
    >>> u, v = np.random.default_rng(0).normal(size=(2, 8, 20))
    >>> a = jax.vmap(chain.acceleration)(np.arange(8.0), u, v)
    >>> found = gx.identify.regression(np.ones(20), terms, np.arange(8.0), u, v, a)
    >>> {name: round(c.value, 6) for name, c in found.coefficients.items()}
    {'e': 1.0, 'e^3': 0.5}
    """
    threshold = float(within("threshold", threshold, 0, 1, open_high=True))
    ridge = float(non_negative("ridge", ridge))
    known = (known,) if isinstance(known, Term) else tuple(known)
    ts, us, vs = jax.tree.map(lambda x: parameter("ts, us, vs", x), (ts, us, vs))
    for name, x in (("us", us), ("vs", vs), ("accelerations", accelerations)):
        shapes = [np.shape(leaf) for leaf in jax.tree.leaves(x)]
        if any(shape[:1] != ts.shape for shape in shapes):
            refuse(
                name,
                f"numbers at every one of the times, shape {ts.shape} and sites",
                f"shapes {shapes}",
            )
    sites = jax.tree.map(lambda x: x.shape[1:], us)
    if not isinstance(mass, dict) and np.ndim(mass) == 0:
        mass = jax.tree.map(lambda x: np.full(x.shape[1:], mass), us)
    if sites != Lattice(mass, known).shape:
        refuse("mass and us", "the same sites", f"{Lattice(mass, known).shape} and {sites}")
    uncertain = 0.0
    if accelerations is None:
        accelerations, uncertain, inner = _differentiated(ts, vs, noise)
        ts, us, vs = jax.tree.map(lambda x: x[inner], (ts, us, vs))
    a = _flat(jax.tree.map(lambda x: parameter("accelerations", x), accelerations))
    terms = [known, *((make(1.0),) for make in candidates.values())]
    columns = _accelerations([Lattice(mass, own) for own in terms], ts, us, vs)
    given, *columns = map(_flat, columns)
    A = np.stack(columns, -1)
    if a.shape != A.shape[:1]:
        refuse("accelerations", f"{len(A)} numbers, as the displacements", f"{len(a)}")
    if len(a) <= len(candidates):
        refuse("ts", f"more numbers than the {len(candidates)} candidates", f"{len(a)}")
    target = a - given
    if not target.any():
        refuse(
            "accelerations", "some that are not zero", "none", "A lattice at rest shows no force."
        )
    for name, column in zip(candidates, A.T):
        if not column.any():
            expected = "a force somewhere along the motion"
            refuse(f"candidates[{name!r}]", expected, "none", "Leave it out.")
    c, kept = _thresholded(A, target, threshold, ridge)
    residual = target - A @ c
    size = np.sqrt(np.mean(target**2))
    rms = np.sqrt(np.mean(residual**2))
    least = max(MARGIN * uncertain, ROUNDING * float(jnp.finfo(ts.dtype).eps) * size)
    leaves = jax.tree.leaves(accelerations)
    parts = np.split(residual, np.cumsum([x.size for x in leaves])[:-1])
    in_time = neighbours([part.reshape(x.shape) for part, x in zip(parts, leaves)])
    pairs = in_time, _alike(residual, A)
    shared = rms * max(structure(*both, rms, least) for both in pairs)
    spread = np.sqrt(residual @ residual / (len(target) - kept.sum()))
    widths = np.linalg.norm(A[:, kept], axis=0)
    seen = directions(A[:, kept], 1 / widths, spread)
    matrix = covariance(seen, 1 / widths)
    shares = np.abs(c[kept]) * widths / np.linalg.norm(target)
    rows = np.stack([c[kept], np.sqrt(np.diag(matrix)), shares], -1).tolist()
    names = tuple(itertools.compress(candidates, kept))
    coefficients = {name: Coefficient(*row) for name, row in zip(names, rows)}
    built = {name: _built(candidates[name], x.value) for name, x in coefficients.items()}
    refused = tuple(name for name, term in built.items() if term is None)
    return Regression(
        coefficients=coefficients,
        dropped=tuple(itertools.compress(candidates, ~kept)),
        names=names,
        covariance=matrix,
        r_squared=float(1 - residual @ residual / np.sum((target - target.mean()) ** 2)),
        noise=float(spread),
        condition=float(np.linalg.cond(A[:, kept] / widths)),
        lattice=None if refused else Lattice(mass, (*built.values(), *known)),
        refused=refused,
        residue=float(shared / size),
    )


@compiled
def _accelerations(lattices, ts, us, vs):
    return [jax.vmap(lattice.acceleration)(ts, us, vs) for lattice in lattices]


def _flat(tree):
    return np.concatenate([np.asarray(x).ravel() for x in jax.tree.leaves(tree)])


def _differentiated(ts, vs, noise):
    # Return accelerations at inner times, the rms of their error, and the slice of these times.
    if len(ts) < 12:
        refuse(
            "ts",
            "twelve times or more, to differentiate velocities",
            f"{len(ts)}",
            "Or give accelerations=.",
        )
    t = np.asarray(ts)
    inner = slice(3, -3)
    deviation = float(non_negative("noise", noise))
    left = len(t) * deviation * deviation

    def derivative(v, every):
        sites = np.asarray(v).reshape(len(t), -1)[::every].T
        splines = [
            scipy.interpolate.UnivariateSpline(t[::every], x, k=5, s=left / every) for x in sites
        ]
        return np.stack([spline.derivative()(t) for spline in splines], -1).reshape(v.shape)[inner]

    found, coarse = (jax.tree.map(lambda v: derivative(v, every), vs) for every in (1, 2))
    # The difference is the error itself if noise dominates, else that of twice the sampling
    # interval, which is larger.
    return found, float(np.sqrt(np.mean((_flat(found) - _flat(coarse)) ** 2))), inner


def _alike(residual, A):
    # Return pairs of residuals with nearly equal candidate columns, each pair once.
    some = np.unique(np.linspace(0, len(A) - 1, min(len(A), MOST)).astype(int))
    places = A[some] / np.sqrt(np.mean(A**2, axis=0))
    nearest = scipy.spatial.cKDTree(places).query(places, 2)[1]
    return tuple(residual[some[np.unique(np.sort(nearest, axis=1), axis=0)]].T)


def _thresholded(A, y, threshold, ridge):
    sizes = np.linalg.norm(A, axis=0)
    kept = np.ones(len(sizes), bool)

    def solved(ridge):
        # The normal matrix would square the condition number; the augmented matrix does not.
        c = np.zeros(len(sizes))
        more = np.sqrt(ridge) * np.eye(kept.sum())
        X = np.concatenate([(A / sizes)[:, kept], more])
        c[kept] = np.linalg.lstsq(X, np.append(y, np.zeros(len(more))), rcond=None)[0]
        return c

    while True:
        stays = kept & (np.abs(solved(ridge)) >= threshold * np.linalg.norm(y))
        if (stays == kept).all():
            break
        kept = stays
        if not kept.any():
            refuse(
                "threshold",
                "a share that at least one candidate reaches",
                f"{threshold:g}",
                "Lower it, or offer other terms.",
            )
    return solved(0.0) / sizes, kept


def _built(make, value):
    try:
        return make(value)
    except ValueError:
        return None
