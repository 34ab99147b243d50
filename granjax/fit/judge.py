"""From where a minimiser ended to a `Fit`: errors, directions, remarks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..flow import return_error
from ..measures import overlap
from ..solvers import AbstractSplitting
from ..terms import Bond
from .determined import covariance, directions, quantities, sentences
from .problem import Problem, misfit
from .record import Fit
from .solve import BLIND, CONVERGED, NOT_FINITE, SPENT, Found

NOTICEABLE = 0.1
# a minimiser that has spent its steps has converged if chi^2 could fall by less: a hundredth of a deviation
ARRIVED = 1e-4
EXACT = 1e-30
NEGLIGIBLE = 1e-6

_linearise = eqx.filter_jit(lambda problem, x: problem.linearise(x))


def looked_at(problem, x):
    """A failed `Fit` where the start x has no finite residuals or no derivatives, else `None`."""
    value, jacobian, _ = _linearise(problem, x)
    value, jacobian = np.asarray(value), np.asarray(jacobian)[:, : problem.coordinates.size]
    finite = np.isfinite(value).all() and np.isfinite(jacobian).all()
    if finite and np.any(jacobian):
        return None
    code = BLIND if finite else NOT_FINITE
    return judged(problem, Found(x, 0.5 * np.sum(value**2), np.zeros((), int), np.asarray(code)), ())


def judged(problem, found, starts, adjoint="forward mode"):
    """The `Fit` at what a minimiser found."""
    coordinates, x = problem.coordinates, found.x[: problem.coordinates.size]
    windows, plain = (None, problem) if isinstance(problem, Problem) else (problem, problem.problem)
    parameters = coordinates.parameters(x)
    flat, slopes = np.asarray(coordinates.flat(parameters)), np.asarray(coordinates.slopes(x))
    value, jacobian, signals = _linearise(problem, found.x)
    value, jacobian = np.asarray(value), _own(np.asarray(jacobian), flat.size)
    samples = int(sum(np.isfinite(np.asarray(trace.data)).sum() for trace in plain.traces))
    known = all(trace.sigma is not None for trace in plain.traces)
    residuals = [np.asarray(misfit(*both)) for both in zip(plain.traces, signals)]
    squares = sum(np.sum(r**2) for r in residuals)
    # in units of the size of the data where no sigma says more
    noise = 1.0 if known else float(np.sqrt(max(squares, EXACT) / max(samples - flat.size, 1)))
    residuals = tuple(r / noise for r in residuals)
    # signed, so that exponents of a product are those of its factors; near zero what the start was
    least = np.abs(np.asarray(coordinates.flat(coordinates.start)))
    sizes = np.where(flat < 0, -1, 1) * np.maximum(np.abs(flat), least)
    sizes = np.where(sizes != 0, sizes, slopes)
    code, remarks, undetermined, found_directions = int(found.code), [], (), ()
    if code == SPENT and _left(value, jacobian, noise) < ARRIVED:
        code = CONVERGED
    step_error = np.nan
    if code in (NOT_FINITE, BLIND):
        matrix = np.full((flat.size, flat.size), np.nan)
        remarks.append(_silence(plain, parameters) if code == BLIND else "Give a start whose run stays finite.")
    else:
        held = coordinates.at_bounds(parameters)
        if held:
            remarks.append(f"At its bound, and beyond it if it could: {', '.join(held)}.")
        seen = np.abs(slopes) > EXACT
        by_parameter = np.where(seen, jacobian / np.where(seen, slopes, 1), 0.0)
        found_directions = tuple(directions(by_parameter, sizes, noise))
        matrix = covariance(found_directions, sizes)
        names = coordinates.names
        undetermined = sentences(found_directions, names, quantities(plain, parameters, coordinates.flat(parameters),
                                                                     sizes))
        halved = problem.with_step(plain.step / 2)
        step_error = float(np.max(np.abs(np.asarray(_linearise(halved, found.x)[0]) - value))) / noise
        if step_error > NOTICEABLE:
            remarks.append(f"The time step moves the signals by up to {step_error:.2g} sigma: give a shorter step=.")
        if not known:
            remarks.append(f"Noise, as the residuals have it: {noise * float(plain.traces[0].size):.3g}.")
        if windows is not None:
            remarks.append(f"{windows.count} windows, which meet to {float(windows.jumps(found.x)):.2g} sigma.")
    back = way_back(plain, parameters)
    unit = 1.0 if known else float(plain.traces[0].size)
    starts = tuple(cost / noise**2 for cost in starts)
    return Fit(parameters, jnp.asarray(matrix), tuple(coordinates.names), signals, residuals, samples, noise * unit,
               undetermined, found_directions, jnp.asarray(sizes), tuple(remarks), int(found.steps), code,
               float(plain.step), step_error, back, adjoint, starts, plain.traces, plain)


def _left(residuals, jacobian, noise):
    """What chi^2 could still fall by along the directions that the data determine, by Gauss and Newton."""
    basis, s, _ = np.linalg.svd(jacobian, full_matrices=False)
    return np.sum((basis[:, s > NEGLIGIBLE * s[0]].T @ residuals) ** 2) / noise**2


def _own(jacobian, count):
    """The columns of the parameters, without what other free numbers could take up of them."""
    own, others = jacobian[:, :count], jacobian[:, count:]
    if others.shape[1] == 0 or not np.isfinite(jacobian).all():
        return own
    basis = np.linalg.qr(others)[0]
    return own - basis @ (basis.T @ own)


def way_back(problem, parameters):
    """The return error of the run of some parameters; infinite where its solver's steps are not symmetric."""
    if not isinstance(problem.solver, AbstractSplitting):
        return np.inf
    lattice = problem.lattice(parameters)
    steps = np.ceil((problem.t1 - problem.t0) / problem.step).astype(int)
    state = problem.state(parameters, lattice)
    return float(return_error(lattice, state, problem.t0, problem.t1, jnp.asarray(steps), problem.solver))


def _silence(problem, parameters):
    """Why nothing depends on the parameters: contacts that never close."""
    lattice = problem.lattice(parameters)
    times = jnp.linspace(problem.t0, problem.t1, 129)
    run = problem.run(parameters, times)
    said = []
    bonds = [(i, term) for i, term in enumerate(lattice.terms) if isinstance(getattr(term, "term", term), Bond)]
    for k, (i, term) in enumerate(bonds):
        if getattr(term, "term", term).law.overlap(jnp.zeros(())) is None:
            continue
        gaps = jax.vmap(lambda t, u, v: overlap(lattice, (u, v), t, bond=k))(run.ts, run.us, run.vs)
        never = np.flatnonzero(~np.any(np.asarray(gaps) > 0, axis=0))
        if never.size:
            shown = ", ".join(map(str, never[:6])) + (" ..." if never.size > 6 else "")
            said.append(f"Contacts {shown} of terms[{i}] never close, and an open contact has no derivative.")
    said.append("Start where the motion reaches the sensors.")
    return " ".join(said)

