"""Pages of the reference, made from docstrings and signatures: one for each public module, MyST Markdown."""

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
from pathlib import Path
from types import ModuleType
from typing import Any

import public

import granjax as gx
from granjax.base import types as words

CODE = re.compile(r"(`[^`]+`)")
SPECIAL = re.compile(r"([\\*_<$])")
BOLD = re.compile(r"(\*\*[^*`]+\*\*)")


class Qualified(ast.NodeTransformer):
    """Words of annotations by their full public names, as the module that wrote them means them."""

    def __init__(self, module: str, full: dict[int, str]):
        self.known, self.full = vars(sys.modules[module]), full

    def visit_Name(self, node):
        value = self.known.get(node.id)
        if node.id in words.__annotations__ and value is vars(words)[node.id]:
            return ast.parse(f"gx.types.{node.id}", mode="eval").body
        return ast.parse(self.full[id(value)], mode="eval").body if id(value) in self.full else node


class Names:
    """Public names, and how text links to them."""

    def __init__(self):
        self.objects = public.objects(gx)
        self.modules = dict(public.modules(gx))
        self.known = {f"{page}.{name}" for page, name, _ in self.objects}
        # where else a name can be reached: `gx.breathers.Orbit` and `gx.orbits.Orbit` are one
        self.first = {id(value): f"{page}.{name}" for page, name, value in self.objects}
        self.same = {
            f"{page}.{name}": self.first[id(getattr(module, name))]
            for page, module in self.modules.items()
            for name in public.names_of(module)
            if id(getattr(module, name)) in self.first
        }

    def link(self, text: str, page: str, own: set[str]) -> str:
        """A word of code, as a link where it names something public that is not an argument of its own."""
        word = text.removeprefix("granjax.") if text.startswith("granjax.") else text
        if word in own or "(" in word:
            return f"`{text}`"
        for full in (word, f"gx.{word}", f"{page}.{word}"):
            if full in self.same:
                return f"{{py:obj}}`{text} <{self.same[full]}>`"
            if full in self.modules and full != "gx":
                return f"{{doc}}`{text} </reference/{full}>`"
        return f"`{text}`"


def prose(text: str, page: str, own: set[str], names: Names) -> str:
    """A docstring as Markdown: doctest blocks fenced, names linked, what Markdown would read otherwise escaped."""
    lines = []
    block = []

    def close():
        if block:
            lines.extend(["```pycon", *block, "```", ""])
            block.clear()

    for line in [*text.splitlines(), ""]:
        if line.startswith(">>> ") or block and line.strip():
            block.append(line)
            continue
        close()
        lines.append(line if line.startswith("    ") else _line(line, page, own, names))
    return "\n".join(lines)


def _line(line, page, own, names):
    parts = CODE.split(line)
    for i, part in enumerate(parts):
        if i % 2:
            parts[i] = names.link(part[1:-1], page, own)
        else:
            bold = BOLD.split(part)
            bold[::2] = [SPECIAL.sub(r"\\\1", x) for x in bold[::2]]
            parts[i] = "".join(bold)
    return "".join(parts)


def _tree(value):
    """The definition of a function or class in its source."""
    return ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(value)))).body[0]


def _arguments(value, names):
    tree = _tree(value)
    qualified = Qualified(inspect.unwrap(value).__module__, names.first)
    args = tree.args
    for x in ast.walk(args):
        if isinstance(x, ast.arg) and x.annotation is not None:
            x.annotation = qualified.visit(x.annotation)
    if tree.returns is not None:
        tree.returns = qualified.visit(tree.returns)
    for group in (args.posonlyargs, args.args):
        if group and group[0].arg in ("self", "cls"):
            del group[0]
    # defaults of what was left stay at the end
    result = (
        f" -> {ast.unparse(tree.returns)}"
        if tree.returns is not None and tree.name != "__init__"
        else ""
    )
    every = [
        *args.posonlyargs,
        *args.args,
        *args.kwonlyargs,
        *filter(None, (args.vararg, args.kwarg)),
    ]
    return f"({ast.unparse(args)}){result}", {a.arg for a in every}


def signature(value: Any, names: Names) -> tuple[str, set[str]]:
    """Arguments with their types, as they are written in the source, and their names; of records no arguments."""
    if not inspect.isclass(value):
        return _arguments(value, names)
    own = {
        k
        for c in value.__mro__
        if c.__module__.startswith("granjax")
        for k in vars(c).get("__annotations__", {})
    }
    if issubclass(value, gx.Result) and "__init__" not in vars(value):
        return "", own
    for kind in value.__mro__:
        start = vars(kind).get("__init__")
        if inspect.isfunction(start) and "granjax" in inspect.unwrap(start).__code__.co_filename:
            text, more = _arguments(start, names)
            return text, own | more
    if dataclasses.is_dataclass(value) or hasattr(value, "_fields"):
        qualified = Qualified(value.__module__, names.first)
        rows = [
            f"{n.target.id}: {ast.unparse(qualified.visit(n.annotation))}"
            for n in _tree(value).body
            if isinstance(n, ast.AnnAssign)
            and isinstance(n.target, ast.Name)
            and not n.target.id.startswith("_")
            and "ClassVar" not in ast.unparse(n.annotation)
        ]
        return f"({', '.join(rows)})", own
    return "", own


def members(value: type) -> list[tuple[str, str, Any]]:
    """(kind, name, function) of a class's own public methods and properties that say what they are."""
    found = []
    for name, x in vars(value).items():
        if name.startswith("_"):
            continue
        if isinstance(x, property) and x.fget is not None and x.fget.__doc__:
            found.append(("property", name, x.fget))
        elif isinstance(x, (staticmethod, classmethod)) and x.__func__.__doc__:
            found.append(("method", name, x.__func__))
        elif inspect.isfunction(inspect.unwrap(x)) and x.__doc__ if callable(x) else False:
            found.append(("method", name, x))
    return found


def _entry(page, name, value, names):
    text, own = signature(value, names)
    kind = "class" if inspect.isclass(value) else "function"
    body = inspect.cleandoc(
        (vars(value).get("__doc__") if kind == "class" else value.__doc__) or ""
    )
    lines = [f"::::{{py:{kind}}} {page}.{name}{text}", "", prose(body, page, own | {name}, names)]
    for sort, inner, function in members(value) if kind == "class" else ():
        if sort == "property":
            head = inner
            mine = set()
        else:
            arguments, mine = _arguments(function, names)
            head = inner + arguments
        said = prose(inspect.cleandoc(function.__doc__), page, own | mine, names)
        lines += [f":::{{py:{sort}}} {head}", "", said, ":::", ""]
    return "\n".join([*lines, "::::", ""])


def summary(value: Any, page: str, names: Names) -> str:
    """The first sentence of a docstring, on one line."""
    text = inspect.cleandoc(
        (vars(value).get("__doc__") if inspect.isclass(value) else value.__doc__) or ""
    )
    first = " ".join(text.partition("\n\n")[0].split())
    return _line(first, page, set(), names).replace("|", r"\|")


def page(name: str, module: ModuleType, names: Names) -> str:
    """The page of a module."""
    own = [(n, value) for where, n, value in names.objects if where == name]
    # what is called comes before what it returns
    own.sort(key=lambda row: inspect.isclass(row[1]) and issubclass(row[1], gx.Result))
    intro = inspect.getdoc(module) or ""
    if module is gx:
        intro = "Everything that `import granjax as gx` shows; its modules have pages of their own."
    lines = [f"# {name}", "", prose(intro, name, set(), names)]
    inner = [other for other in names.modules if other.rpartition(".")[0] == name and name != "gx"]
    if inner:
        lines += [
            "Modules: " + ", ".join(f"{{doc}}`{m} </reference/{m}>`" for m in inner) + ".",
            "",
        ]
    elsewhere = [
        (n, names.same[f"{name}.{n}"])
        for n in public.names_of(module)
        if f"{name}.{n}" in names.same and names.same[f"{name}.{n}"] != f"{name}.{n}"
    ]
    if own:
        lines += ["| name | what |", "|---|---|"]
        lines += [
            f"| {{py:obj}}`{n} <{name}.{n}>` | {summary(value, name, names)} |" for n, value in own
        ]
        lines += [""]
    if elsewhere:
        lines += [
            "Also here: " + ", ".join(f"{{py:obj}}`{n} <{full}>`" for n, full in elsewhere) + ".",
            "",
        ]
    return "\n".join(lines + [_entry(name, n, value, names) for n, value in own])


def overview(names: Names) -> str:
    """All names by what they are for: the table in the docstring of granjax."""
    lines = [
        "# Reference",
        "",
        "Every public name and its types, with an example where one looks first. In the examples `gx` is granjax,",
        "`np` NumPy, `jnp` `jax.numpy`, `plt` `matplotlib.pyplot`. What the words of the types mean is [on a page",
        "of its own](types).",
        "",
    ]
    for line in gx.__doc__.partition("`help(gx.simulate)`")[2].splitlines()[1:]:
        row = re.match(r"    (\w+)\s+(.*)", line)
        if row:
            lines.append(
                f"| {names.link(f'gx.{row[1]}', 'gx', set())} | {_line(row[2], 'gx', set(), names)} |"
            )
        elif line.strip():
            lines += ["", f"## {line.strip()}", "", "| name | what |", "|---|---|"]
    listed = "\n".join(["types", *names.modules])
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", listed, "```", ""])


def type_words() -> str:
    """The page of the words that annotations use."""
    source = ast.parse(inspect.getsource(words)).body
    lines = ["# Types", "", inspect.getdoc(words), ""]
    for node, said in zip(source, source[1:]):
        if (
            isinstance(node, ast.AnnAssign)
            and isinstance(said, ast.Expr)
            and isinstance(said.value, ast.Constant)
        ):
            lines += [
                f":::{{py:type}} gx.types.{node.target.id}",
                f":canonical: {ast.unparse(node.value)}",
                "",
                said.value.value,
                ":::",
                "",
            ]
    return "\n".join(lines)


def write(folder: Path) -> None:
    """All pages of the reference."""
    folder.mkdir(exist_ok=True)
    names = Names()
    made = {"index": overview(names), "types": type_words()}
    made |= {name: page(name, module, names) for name, module in names.modules.items()}
    keep(folder, {f"{name}.md": text for name, text in made.items()})


def keep(folder: Path, made: dict[str, str]) -> None:
    """Write the files that differ, and let go of pages that are no more, so that a second build reads few."""
    for old in folder.glob("*.md"):
        if old.name not in made:
            old.unlink()
    for name, text in made.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
