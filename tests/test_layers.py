"""Modules stand on floors: imports point downwards, without circles; the code keeps a few rules of style."""

import ast
from pathlib import Path

import granjax

ROOT = Path(granjax.__file__).parent

FLOORS = (
    {"base"},
    {"results", "materials", "solvers", "strains", "laws"},
    {"terms"},
    {"lattice"},
    {"continuation"},
    {"flow", "profiles", "scenes"},
    {"theory"},
    {"linear", "measures"},
    {"states", "first_order"},
    {"orbits"},
    {"breathers", "driven", "floquet", "forced", "shocks", "travelling", "plots"},
    {"sweeps", "fit", "work_precision"},
    {"resonance"},
)
FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}
# the face, and the command line, which stands on it
ABOVE = {"__init__", "__main__"}

FILES = sorted(ROOT.rglob("*.py"))


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


def test_every_module_has_a_floor_and_imports_point_downwards():
    for path in FILES:
        own = module_of(path)
        assert own in FLOOR.keys() | ABOVE, path
        for other in imports(path) if own not in ABOVE else ():
            assert other not in ABOVE | {""}, f"{path} imports the face"
            assert other != "plots", f"{path} imports plots"
            assert FLOOR[other] < FLOOR[own], f"{path} imports {other}, which is not below it"
    # the reading of imports sees them
    assert {"laws", "strains"} <= imports(ROOT / "terms" / "bonds.py")
    assert imports(ROOT / "base" / "checks.py") == set()


def test_there_is_no_circle_within_a_folder():
    for folder in [path for path in ROOT.iterdir() if (path / "__init__.py").is_file()]:
        files = {path.stem: path for path in folder.glob("*.py") if path.stem != "__init__"}
        edges = {
            stem: {
                name.split(".")[2]
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, (ast.Import, ast.ImportFrom))
                for name in absolute(path, node)
                if name.split(".")[:2] == ["granjax", folder.name] and len(name.split(".")) > 2
            }
            & files.keys()
            for stem, path in files.items()
        }
        while edges:
            leaves = {stem for stem, below in edges.items() if not below & edges.keys() - {stem}}
            assert leaves, f"{folder.name}: a circle among {sorted(edges)}"
            edges = {stem: below for stem, below in edges.items() if stem not in leaves}


def test_no_print_no_assert_no_bare_except_and_every_public_name_is_documented():
    for path in FILES:
        tree = ast.parse(path.read_text())
        said = module_of(path) == "__main__"
        for node in ast.walk(tree):
            assert not isinstance(node, ast.Assert), (path, node.lineno)
            called = isinstance(node, ast.Call) and getattr(node.func, "id", None) == "print"
            assert said or not called, (path, node.lineno)
            if isinstance(node, ast.ExceptHandler):
                # whatever a function of the user's raises marks a lane, or is said below sliders
                alone = module_of(path) == "sweeps" or path.name in {"explore.py", "batching.py"}
                bare = {None} if alone else {None, "Exception", "BaseException"}
                assert node.type is not None and getattr(node.type, "id", "") not in bare, (
                    path,
                    node.lineno,
                )
        assert ast.get_docstring(tree), path
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                assert ast.get_docstring(node), (path, node.name)
