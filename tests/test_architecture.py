"""How the files of the package hang together: library and study apart, no circles, nothing of ``stages``."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = "hybrid_dynamics"
SOURCE = Path(__file__).parents[1] / "src"


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted((SOURCE / PACKAGE).rglob("*.py"))}


@cache
def imports(module: str) -> frozenset[str]:
    """Every module of the package that ``module`` names, also inside functions and under TYPE_CHECKING."""
    return frozenset(found_in(ast.parse(MODULES[module].read_text("utf-8")), frozenset(MODULES)) - {module})


def found_in(tree: ast.AST, modules: frozenset[str]) -> set[str]:
    """Those of ``modules`` that ``tree`` imports, as ``import a.b`` or ``from a import b`` (b a module or a name)."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & modules
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import; name the module in full"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                found |= {name if name in modules else str(node.module)} & modules
    return found


def circle(edges: dict[str, frozenset[str]]) -> list[str]:
    """Modules that import one another in turn, first and last the same; empty where there are none."""
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> list[str]:
        if module in path:
            return [*path[path.index(module) :], module]
        if module in done:
            return []
        for other in sorted(edges[module]):
            if found := visit(other, (*path, module)):
                return found
        done.add(module)
        return []

    for module in sorted(edges):
        if found := visit(module, ()):
            return found
    return []


@pytest.mark.parametrize("module", [m for m in MODULES if not m.startswith(f"{PACKAGE}.study")])
def test_the_library_does_not_import_the_study(module: str) -> None:
    of_study = sorted(m for m in imports(module) if m.startswith(f"{PACKAGE}.study"))
    assert not of_study, f"{module} imports {of_study}; move what it needs out of study/"


def test_no_files_import_one_another_in_a_circle() -> None:
    found = circle({module: imports(module) for module in MODULES})
    assert not found, " -> ".join(found)


def test_nothing_in_the_package_imports_the_stages() -> None:
    names = frozenset({"stages"})
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text("utf-8"))
        roots = {name.split(".")[0] for name in _roots(tree)}
        assert not roots & names, f"{module} imports stages"


def _roots(tree: ast.AST) -> set[str]:
    plain = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    return plain | {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}


def test_the_circle_finder_finds_a_circle_and_imports_inside_functions() -> None:
    """The wrong-cause control: hidden in a function, through a third file."""
    modules = frozenset({"p.a", "p.b", "p.c"})
    texts = {"p.a": "from p import b", "p.b": "def f():\n    from p.c import x", "p.c": "import p.a"}
    edges = {name: frozenset(found_in(ast.parse(text), modules)) for name, text in texts.items()}
    assert circle(edges) == ["p.a", "p.b", "p.c", "p.a"]
    assert circle({**edges, "p.c": frozenset()}) == []
