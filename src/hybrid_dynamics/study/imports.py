"""Which files of this repository a program imports: read from the source, nothing is run.

Imports inside functions count. A package that offers its names lazily (a stub ``__init__.pyi``) is followed to the
module of the name that is asked for; a package that imports whatever lies in its folder, to all of it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

PACKAGE = "hybrid_dynamics"
#: Folders of the package whose files serve different programs.
MIXED = ("models", "study")


class SourceTree:
    """The modules below ``root/src/hybrid_dynamics`` and ``root/stages``, and what each imports."""

    def __init__(self, root: Path) -> None:
        self.root = root
        files = [*(root / "src" / PACKAGE).rglob("*.py"), *(root / "stages").glob("*.py")]
        #: Module name -> file.
        self.modules: dict[str, Path] = {self._name(path): path for path in sorted(files)}

    def _name(self, path: Path) -> str:
        relative = path.relative_to(self.root)
        parts = (relative.relative_to("src") if relative.parts[0] == "src" else relative).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    @cached_property
    def edges(self) -> dict[str, frozenset[str]]:
        """Module -> the modules it names in an import."""
        return {name: self._imports(name) for name in self.modules}

    def _imports(self, module: str) -> frozenset[str]:
        path = self.modules[module]
        tree = ast.parse(path.read_text("utf-8"))
        found: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found |= {self._home(node.module, alias.name) for alias in node.names}
            elif isinstance(node, ast.Attribute) and node.attr == "iter_modules":
                found |= {name for name in self.modules if name.startswith(f"{module}.")}
        return frozenset(found & self.modules.keys()) - {module}

    def _home(self, package: str, name: str) -> str:
        """The module that ``from package import name`` needs."""
        whole = f"{package}.{name}"
        if whole in self.modules or package not in self.modules:
            return whole
        stub = self.modules[package].with_suffix(".pyi")
        if stub.is_file():
            for node in ast.parse(stub.read_text("utf-8")).body:
                if isinstance(node, ast.ImportFrom) and any(alias.name == name for alias in node.names):
                    return f"{package}.{node.module}" if node.level else str(node.module)
        return package

    def closure(self, roots: Iterable[str]) -> set[str]:
        """``roots`` and all modules they need, the packages around them included (Python runs their ``__init__``)."""
        seen: set[str] = set()
        waiting = [name for name in roots if name in self.modules]
        while waiting:
            module = waiting.pop()
            if module in seen:
                continue
            seen.add(module)
            parts = module.split(".")
            packages = {".".join(parts[:k]) for k in range(1, len(parts))} & self.modules.keys()
            waiting += [*self.edges[module], *packages]
        return seen

    def files(self, modules: Iterable[str]) -> set[Path]:
        """Files of ``modules``, relative to the root, with the data files that they read beside them."""
        out: set[Path] = set()
        for module in modules:
            path = self.modules[module]
            out.add(path.relative_to(self.root))
            if "importlib.resources import files" in path.read_text("utf-8"):
                beside = (p for p in path.parent.iterdir() if p.suffix in (".json", ".css", ".html"))
                out |= {p.relative_to(self.root) for p in beside}
        return out

    def compact(self, files: set[Path]) -> list[str]:
        """``files`` sorted, and a folder of the package instead of those of its files that are there.

        But for the folders of :data:`MIXED`, whose files serve different programs: a change of one concerns few.
        """
        return sorted({self._room(path).as_posix() for path in files})

    def _room(self, path: Path) -> Path:
        rooms = [folder for folder in path.parents if folder.parts[:1] == ("src",) and len(folder.parts) > 2]
        whole = [folder for folder in rooms if folder.relative_to(Path("src") / PACKAGE).as_posix() not in MIXED]
        return whole[-1] if whole else path
