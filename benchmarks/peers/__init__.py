"""What others would use for a Hertz chain, each in its own best style, for comparisons in one process.

Every module of a peer has `PARAMETER` (`"step"` or `"tolerance"`) and `calls(chain) -> {name: call}`; `call(parameter)`
runs from the chain's start to its end and returns the final (u, v). For a step the parameter is the number of steps.
`gather` asks all of them and says who is missing, and why.
"""

from importlib import import_module

from .chain import Chain, Unfit

KINDS = ("loops", "nystrom", "native", "compiled", "scipys", "taylor", "explicit")
PACKAGES = ("numba", "scipy", "numbalsoda", "heyoka", "diffrax")
_LOOPS = ("hertz", "hertz_free", "power", "hertz_batch")

__all__ = ["Chain", "KINDS", "PACKAGES", "Unfit", "gather"]


def __getattr__(name):
    """The loops of `_LOOPS`, `packing` of the plane, and the rates `hertz_rates`, loaded when first asked for."""
    if name in _LOOPS:
        return getattr(import_module(".loops", __name__), name)
    if name == "packing":
        return import_module(".plane", __name__).packing
    if name == "hertz_rates":
        return import_module(".rates", __name__).hertz_rates
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def gather(chain, kinds=KINDS):
    """({name: (parameter, call)}, {kind: why it is left out})."""
    found = {}
    left_out = {}
    for kind in kinds:
        try:
            module = import_module(f".{kind}", __name__)
            found |= {name: (module.PARAMETER, call) for name, call in module.calls(chain).items()}
        except (ImportError, OSError, Unfit) as error:
            left_out[kind] = str(error)
    return found, left_out
