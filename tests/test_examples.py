"""Every public docstring has an example, and the examples run, those of a module in one process.

`python tests/test_examples.py gx.linear gx.theory` runs those of some modules and says what failed, what has none, and
what took longest.
"""

import doctest
import importlib.util
import inspect
import io
import sys
import time
from pathlib import Path

import matplotlib
import pytest

matplotlib.use("Agg")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import granjax as gx  # noqa: E402

spec = importlib.util.spec_from_file_location("public", Path(__file__).parents[1] / "docs" / "public.py")
public = importlib.util.module_from_spec(spec)
spec.loader.exec_module(public)

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# what an example may take for granted
KNOWN = {"gx": gx, "jax": jax, "jnp": jnp, "np": np, "plt": plt}
PARSER = doctest.DocTestParser()


def example(page, name, value):
    """The example of a public name, or `None`. A class may have its own in the docstring of `__init__`."""
    words = vars(value).get("__doc__") if inspect.isclass(value) else value.__doc__
    found = PARSER.get_doctest(inspect.cleandoc(words or ""), dict(KNOWN), f"{page}.{name}", None, 0)
    return found if found.examples else None


def run(test):
    """What an example prints in place of what it should, empty where it is right; and the seconds that it took."""
    said, start = io.StringIO(), time.perf_counter()
    doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(test, out=said.write)
    plt.close("all")
    return said.getvalue(), time.perf_counter() - start


def test_every_public_docstring_has_an_example():
    found = public.objects(gx)
    assert len(found) > 500
    bare = [f"{page}.{name}" for page, name, value in found if example(page, name, value) is None]
    assert not bare, "\n".join(bare)


@pytest.mark.site
@pytest.mark.parametrize("page", list(dict.fromkeys(page for page, _, _ in public.objects(gx))))
def test_examples_of_docstrings_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tests = [example(*row) for row in public.objects(gx) if row[0] == page]
    wrong = [said for said, _ in (run(test) for test in tests if test is not None) if said]
    assert not wrong, "\n".join(wrong)


def main(pages):
    """Run the examples of some public modules, or of names in them."""
    bare, took = [], []
    for page, name, value in public.objects(gx):
        if not any(p in (page, f"{page}.{name}") for p in pages):
            continue
        test = example(page, name, value)
        if test is None:
            bare.append(f"{page}.{name}")
            continue
        said, seconds = run(test)
        took.append((seconds, f"{page}.{name}"))
        print(said, end="")
    print("without an example:", *bare or ["none"])
    print("seconds:", f"{sum(t for t, _ in took):.1f},", ", ".join(f"{n} {t:.1f}" for t, n in sorted(took)[:-9:-1]))


if __name__ == "__main__":
    main(sys.argv[1:])
