"""Integrators as diffrax solvers on y = (u, v): each is a class with a table of coefficients."""

from .nystrom import RKN86, RKN1210, AbstractNystrom
from .splitting import (
    ABA864,
    AbstractSplitting,
    KahanLi8,
    SofroniouSpaletta10,
    SRKN6b,
    SRKN11b,
    SRKN14a,
    VelocityVerlet,
)

__all__ = [
    "ABA864",
    "AbstractNystrom",
    "AbstractSplitting",
    "KahanLi8",
    "RKN1210",
    "RKN86",
    "SRKN11b",
    "SRKN14a",
    "SRKN6b",
    "SofroniouSpaletta10",
    "VelocityVerlet",
]
