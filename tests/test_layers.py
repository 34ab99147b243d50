import ast
import importlib
import inspect
from pathlib import Path

import pytest

import granjax

ROOT = Path(granjax.__file__).parent

FLOORS = (
    {"checks", "files", "outside", "printing", "tuning", "types"},
    {"entry", "programs", "variables"},
    {"split_system", "units"},
    {"results"},
    {"laws", "strains", "materials", "solvers", "newton", "parameters", "descent", "plots", "fractional"},
    {"terms", "continuation"},
    {"lattice"},
    {"equilibria"},
    {"flow", "profiles", "scenes"},
    {"theory"},
    {"linear"},
    {"first_order", "measures", "states"},
    {"orbits"},
    {"topology", "breathers", "canonical", "driven", "floquet", "forced", "kinks", "shocks", "travelling"},
    {"sweeps", "fit", "design", "work_precision"},
    {"identify", "studies"},
)
FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}
# the face, and what stands on it: the command line, notebooks
ABOVE = {"__init__", "__main__", "cli", "notebook"}

FILES = sorted(ROOT.rglob("*.py"))
IDS = [str(path.relative_to(ROOT)) for path in FILES]


def module_of(path):
    """Name of the module or folder directly under granjax that a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def absolute(path, node):
    """The dotted names that an import statement of a file names, from `granjax` on."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    package = ["granjax", *path.relative_to(ROOT).parent.parts]
    base = package[: len(package) - node.level + 1] if node.level else []
    base = base + (node.module.split(".") if node.module else [])
    return [".".join([*base, alias.name]) for alias in node.names]


def imports(path):
    """Modules directly under granjax that a file imports, other than its own; "" is the face itself."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            for name in absolute(path, node):
                parts = name.split(".")
                if parts[0] == "granjax":
                    known = len(parts) > 1 and (parts[1] in FLOOR or parts[1] in ABOVE)
                    found.add(parts[1] if known else "")
    return found - {module_of(path)}


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_every_module_has_a_floor(path):
    assert module_of(path) in FLOOR.keys() | ABOVE


@pytest.mark.parametrize("path", [path for path in FILES if module_of(path) not in ABOVE],
                         ids=[i for path, i in zip(FILES, IDS) if module_of(path) not in ABOVE])
def test_imports_point_downwards(path):
    own = module_of(path)
    for other in imports(path):
        assert other not in ABOVE | {""}, f"{own} imports the face"
        assert other != "plots", f"{own} imports plots"
        assert other == "checks" or FLOOR[other] < FLOOR[own], f"{own} imports {other}, which is not below it"


KINDS = {
    name: folder for folder, names in (
        ("laws", ("Hertz", "PowerLaw", "Polynomial", "Toda", "Linear", "Sine", "Spline", "Network", "Sum", "Scaled",
                  "Strained", "Yielding", "Indented")),
        ("strains", ("Shift", "Stencil", "Pairs", "Stretch", "LinearMap", "Slip", "Along")),
        ("terms", ("Bond", "Modulated", "OnSite", "Damping", "Dashpot", "ViscousContact", "Drag", "Drive", "LongRange",
                   "Wall", "PlasticContact", "CaputoDamping", "BrilliantovContact", "Grip")),
    ) for name in names
}


def test_the_kinds_are_all_there_are():
    for folder in ("laws", "strains", "terms"):
        module = importlib.import_module(f"granjax.{folder}")
        base = {"laws": granjax.Law, "strains": granjax.StrainMap, "terms": granjax.Term}[folder]
        concrete = {name for name, value in vars(module).items() if inspect.isclass(value) and issubclass(value, base)}
        assert concrete - {base.__name__} == {name for name, where in KINDS.items() if where == folder}


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_nobody_asks_a_kind_what_it_is(path):
    """No isinstance or type() test on a law, a strain map or a term outside of the folder that defines it."""
    for node in ast.walk(ast.parse(path.read_text())):
        asks = isinstance(node, ast.Call) and getattr(node.func, "id", None) in ("isinstance", "issubclass")
        compares = isinstance(node, ast.Compare) and any(
            isinstance(side, ast.Call) and getattr(side.func, "id", None) == "type"
            for side in (node.left, *node.comparators))
        if asks or compares:
            named = {getattr(n, "id", None) or getattr(n, "attr", None) for n in ast.walk(node)}
            assert not {name for name in named if KINDS.get(name, module_of(path)) != module_of(path)}


def test_checks_import_nothing_of_the_library():
    assert imports(ROOT / "checks.py") == set()


@pytest.mark.parametrize("own, other", [("lattice", "solvers"), ("fit", "floquet")])
def test_folders_that_need_not_know_each_other(own, other):
    assert all(other not in imports(path) for path in (ROOT / own).glob("*.py"))


def test_the_reading_of_imports_sees_them():
    assert {"laws", "strains", "entry"} <= imports(ROOT / "terms" / "bonds.py")
    assert "terms" in imports(ROOT / "lattice" / "model.py")


def test_no_file_name_stands_in_three_folders():
    names = [path.name for path in FILES if path.name != "__init__.py"]
    assert not {name for name in names if names.count(name) > 2}


def test_there_is_no_circle_within_a_folder():
    for folder in [path for path in ROOT.iterdir() if (path / "__init__.py").is_file()]:
        files = {path.stem: path for path in folder.glob("*.py") if path.stem != "__init__"}
        edges = {stem: {name.split(".")[2] for node in ast.walk(ast.parse(path.read_text()))
                        if isinstance(node, (ast.Import, ast.ImportFrom)) for name in absolute(path, node)
                        if name.split(".")[:2] == ["granjax", folder.name] and len(name.split(".")) > 2} & files.keys()
                 for stem, path in files.items()}
        while edges:
            leaves = {stem for stem, below in edges.items() if not below & edges.keys() - {stem}}
            assert leaves, f"{folder.name}: a circle among {sorted(edges)}"
            edges = {stem: below for stem, below in edges.items() if stem not in leaves}


# a process or a thread of its own, of which every error is told to another
ALONE = {ROOT / "sweeps" / name for name in ("function.py", "sweep.py")} | {ROOT / "flow" / "batching.py"}


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_no_print_no_assert_no_bare_except(path):
    for node in ast.walk(ast.parse(path.read_text())):
        assert not isinstance(node, ast.Assert), f"line {node.lineno}"
        if module_of(path) not in {"cli", "__main__"}:
            called = isinstance(node, ast.Call) and getattr(node.func, "id", None) == "print"
            assert not called, f"line {node.lineno}"
        # a process or a thread of its own, of which every error is told to another
        if isinstance(node, ast.ExceptHandler) and path not in ALONE:
            assert getattr(node.type, "id", "named") not in {"Exception", "BaseException"}, f"line {node.lineno}"
            assert node.type is not None, f"line {node.lineno}"


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_every_public_name_is_documented(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree), "the module"
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            assert ast.get_docstring(node), node.name
