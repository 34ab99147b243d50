"""A wrapper whose solver properties are those of the inner solver."""

import diffrax


def _of_solver(name, *otherwise):
    return property(lambda self: getattr(self.solver, name, *otherwise))


class Wrapped(diffrax.AbstractWrappedSolver):
    """A solver with the properties of its `solver`; a subclass adds `init` and `step`."""

    solver: diffrax.AbstractSolver
    term_structure = _of_solver("term_structure")
    interpolation_cls = _of_solver("interpolation_cls")
    scan_kind = _of_solver("scan_kind", None)
    root_finder = _of_solver("root_finder")

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)
