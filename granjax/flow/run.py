"""The record of a run."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..checks import concrete
from ..lattice import State

COMPLETED, NOT_FINITE, TOO_MANY_STEPS, STEP_TOO_SMALL, FAILED = range(5)


class Run(eqx.Module):
    """What `simulate` returns. It prints itself.

    - `ts` (T,), `us`, `vs` (T, N): times, displacements and velocities that were saved (T = 1, the end, by default).
    - `final`: `State` at the last time; `recorded`: dict of the records' results.
    - `energy_error`: largest |E - E0|/max(|E0|, kinetic energy) over the saved times, NaN where a term does not keep
      the energy; shape of the lanes. `contact_opened`: whether any contact was
      open at the end of any step, one that never closed included.
    - `outcome`: a sentence; `completed`: whether the run reached t1 with finite numbers, in every lane.
    - `stats`: dict of `steps`, `accepted`, `rejected`, `step` (the fixed one, or the mean of adaptive ones),
      `force_evaluations` (NaN for diffrax's own solvers). `solver`: its name; `choice`: what was chosen and why.
    """

    ts: jax.Array
    us: object
    vs: object
    final: State
    recorded: dict
    energy_error: jax.Array
    contact_opened: jax.Array
    code: jax.Array
    stats: dict
    failed_at: tuple | None
    solver: str = eqx.field(static=True)
    choice: str = eqx.field(static=True)
    remark: str = eqx.field(static=True)

    @property
    def completed(self):
        return self.code == COMPLETED

    @property
    def outcome(self):
        """What became of the run, in a sentence (only where the run is not traced)."""
        code = concrete(self.code)
        if code is None:
            return "Not known while traced."
        t, steps = float(np.max(np.asarray(self.ts)[..., -1])), int(np.max(self.stats["steps"]))
        sentence = {
            COMPLETED: f"Completed at t = {t:g} after {steps} steps.",
            NOT_FINITE: f"The state is not finite{self._where()}: "
                        "the motion left the law's domain, or the step is too long.",
            TOO_MANY_STEPS: f"Stopped after {steps} steps, the most allowed; give max_steps= or a looser tolerance.",
            STEP_TOO_SMALL: "Stopped: the tolerance asks for steps below what the floating type resolves.",
            FAILED: "The solver reported a failure.",
        }[int(np.max(code))]
        return f"{sentence} {self.remark}".strip()

    def _where(self):
        if self.failed_at is None:
            return ""
        before, after, sites = self.failed_at
        return f" (first between t = {before:g} and {after:g}, at sites {sites})"

    def __repr__(self):
        if concrete(self.code) is None:
            return f"Run({self.solver}, traced)"
        return "\n".join(f"{name:<15}{value}" for name, value in self._rows())

    __str__ = __repr__

    def _rows(self):
        yield "solver", self.solver
        yield "choice", self.choice
        steps = f"{int(np.max(self.stats['steps']))}"
        rejected = int(np.max(self.stats["rejected"]))
        yield "steps", steps + (f", {rejected} of them rejected" if rejected else "")
        yield "step", f"{float(np.max(self.stats['step'])):.6g}"
        yield "energy error", f"{float(np.max(self.energy_error)):.2g}"
        yield "contact opened", "yes" if np.any(self.contact_opened) else "no"
        yield "saved", f"{self.ts.shape[-1]} times" + (f", records {', '.join(self.recorded)}" if self.recorded else "")
        yield "outcome", self.outcome

    def to_numpy(self):
        """A dict of NumPy arrays: ts, us, vs and the records."""
        tree = {"ts": self.ts, "us": self.us, "vs": self.vs, **self.recorded}
        return jax.tree.map(np.asarray, tree)

    def to_xarray(self):
        """An `xarray.Dataset` with displacement `u` and velocity `v` over `time` and `site` (one pair per field).

        Further axes are called `axis_k`; records and the scalars of the run are variables and attributes.
        """
        import xarray as xr

        variables = {}
        for name, tree in (("u", self.us), ("v", self.vs)):
            for field, x in tree.items() if isinstance(tree, dict) else ((None, tree),):
                x = np.asarray(x)
                dims = ("time", "site" if field is None else f"site_{field}", *(f"axis_{k}" for k in range(2, x.ndim)))
                variables[name if field is None else f"{name}_{field}"] = (dims, x)
        for name, x in self.recorded.items():
            x = np.asarray(x)
            variables[name] = (tuple(f"{name}_{k}" for k in range(x.ndim)), x)
        attributes = {"solver": self.solver, "choice": self.choice, "outcome": self.outcome}
        attributes["energy_error"] = np.asarray(self.energy_error).tolist()
        attributes["contact_opened"] = np.asarray(self.contact_opened).astype(int).tolist()
        return xr.Dataset(variables, {"time": np.asarray(self.ts)}, attributes)


def named(run, solver, choice, remark):
    """A run that a compiled function has just returned, with its names.

    Written into it, which nobody else holds yet: making a Module anew takes longer than a short run.
    """
    for field, value in (("solver", solver), ("choice", choice), ("remark", remark)):
        object.__setattr__(run, field, value)
    return run


def finite(tree):
    """Whether every number of a tree is finite."""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))
