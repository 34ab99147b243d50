"""The examples of public docstrings run, those of a module in one process."""

import doctest
import inspect
import io

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import public
import pytest

import granjax as gx

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# what an example may take for granted
KNOWN = {"gx": gx, "jax": jax, "jnp": jnp, "np": np, "plt": plt}
PARSER = doctest.DocTestParser()


def example(page, name, value):
    """The example of a public name, or `None`. A class may have its own in the docstring of `__init__`."""
    words = vars(value).get("__doc__") if inspect.isclass(value) else value.__doc__
    found = PARSER.get_doctest(
        inspect.cleandoc(words or ""), dict(KNOWN), f"{page}.{name}", None, 0
    )
    return found if found.examples else None


def run(test):
    """What an example prints in place of what it should, empty where it is right."""
    said = io.StringIO()
    doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(test, out=said.write)
    return said.getvalue()


@pytest.mark.site
@pytest.mark.parametrize("page", list(dict.fromkeys(page for page, _, _ in public.objects(gx))))
def test_examples_of_docstrings_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tests = [example(*row) for row in public.objects(gx) if row[0] == page]
    wrong = [said for said in (run(test) for test in tests if test is not None) if said]
    assert not wrong, "\n".join(wrong)
