"""Coefficients of the methods, as published, with their sources."""

import json
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np


@cache
def _read():
    return json.loads(resources.files(__package__).joinpath("coefficients.json").read_text())


class Splitting(NamedTuple):
    """A splitting method.

    One step: kick b[0], drift a[0], kick b[1], ..., drift a[s-1], kick b[s], in units of the step.
    """

    a: np.ndarray
    b: np.ndarray
    order: int
    source: str


class Nystrom(NamedTuple):
    """k_i = F(u + c_i h v + h^2 A_ij k_j)/m; weights b, bp of u, v and be, bpe of their errors."""

    A: np.ndarray
    b: np.ndarray
    bp: np.ndarray
    be: np.ndarray
    bpe: np.ndarray
    c: np.ndarray
    order: int
    embedded_order: int
    source: str


def _numbers(x):
    return np.array([[float(z) for z in y] if isinstance(y, list) else float(y) for y in x])


def splitting(name: str) -> Splitting:
    """Return the table of a splitting method by the name of its class."""
    t = _read()["splitting"][name]
    return Splitting(_numbers(t["a"]), _numbers(t["b"]), t["order"], t["source"])


def nystrom(name: str) -> Nystrom:
    """Return the table of a Runge-Kutta-Nystrom pair by the name of its class."""
    t = _read()["nystrom"][name]
    return Nystrom(
        *(_numbers(t[key]) for key in ("A", "b", "bp", "be", "bpe", "c")),
        t["order"],
        t["embedded_order"],
        t["source"],
    )
