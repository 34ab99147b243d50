"""No traceback from inside: bad input for every argument of every public callable meets a sentence.

The cases are made of signatures and types (`generated.py`); a fixed seed chooses those of the fast set.
"""

import generated
import jax
import pytest
from generated import BLANK, Case, cases, chosen, targets, trial

FAST = 1500
ALL = [case for target in targets() for case in cases(target)]


def package(case):
    """The file or folder of granjax that a case belongs to."""
    return case.target.key.split(".")[0]


PACKAGES = sorted({package(case) for case in ALL})


def check(some):
    """Each is refused by a sentence, or of a kind that its annotation admits; and nothing was compiled."""
    found = [(case, trial(case)) for case in some]
    wrong = [f"{case}: {x.kind}{', must be refused' * x.must}: {x.told}" for case, x in found if x and not x.good]
    assert not wrong, f"{len(wrong)} of {len(found)}\n" + "\n".join(wrong[:40])
    assert not generated.COMPILED


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """What is written by name is written into a folder of the test's."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True, scope="module")
def forgotten():
    """Programs that were given up while they were lowered are not left to the tests that follow."""
    yield
    jax.clear_caches()


def check_valid(some):
    """With no argument replaced a call comes as far as computing: what is refused is refused for its own sake."""
    found = {target.key: trial(Case(target, "", "None")) for target in some}
    assert {key for key, x in found.items() if x is None} <= {*BLANK}
    wrong = {key: x.told for key, x in found.items() if x and (x.kind == "accepted") == (key in BLANK)}
    assert not wrong, wrong


def test_valid_calls_are_accepted():
    check_valid([*targets()][::10])


@pytest.mark.study
def test_all_valid_calls_are_accepted():
    check_valid([*targets()])


def test_what_was_found_stays_mended():
    """An aborted process, and raw errors that a user would meet first."""
    found = {
        "flow.simulate.simulate": ("save_at", "2**62"), "theory.nls.bright_profile": ("cells", "2**62"),
        "design.smooth_peak": ("values", "empty"), "orbits.guesses.sites.single_site": ("omega", "0"),
        "orbits.driven_chain.driven_chain": ("damping", "nan"), "lattice.model.Lattice": ("mass", "[]"),
        "flow.stiffness.frequency_bound": ("neighbourhood", "0"), "measures.spectra.spectrogram": ("v", "()"),
        "identify.pinn.physics_informed": ("scene", "gives None"), "scenes.chains.monomer": ("stiffness", "range"),
        "orbits.steps.history": ("frames", "2**62"),
        "studies.dark_breather.dark_by_interference": ("frequency", "1e308"),
        "terms.waveforms.Breaks": ("times", "inf"), "work_precision.ladder.distance": ("state", "complex128"),
    }
    check([Case(target, *found[target.key]) for target in targets() if target.key in found])


# in the units of F
# of residuals, or of an error that may well pass 1
ABSOLUTE = ("newton.newton", "continuation.trace.continuation", "flow.reversible.Reversible")


def test_relative_tolerances_are_below_one():
    for target in targets():
        for name in {"tolerance", "accuracy", "resolution"} & target.arguments().keys():
            found = trial(Case(target, name, "2**62"))
            assert target.key in (*ABSOLUTE, *BLANK) or found.kind == "sentence", (target.key, name, found)


@pytest.mark.parametrize("name", PACKAGES)
def test_bad_input_meets_a_sentence(name):
    check([case for case in chosen(ALL, FAST) if package(case) == name])


@pytest.mark.study
@pytest.mark.parametrize("name", PACKAGES)
def test_all_bad_input_meets_a_sentence(name):
    check([case for case in ALL if package(case) == name])
