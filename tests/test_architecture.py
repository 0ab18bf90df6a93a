"""How the files hang together: library and study apart, no circles, and stages that declare what they import."""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml
from stages.deps import TRAIN, code_of, is_code, update

from hybrid_dynamics.effects import catalogue
from hybrid_dynamics.models.methods import layered
from hybrid_dynamics.study.imports import PACKAGE, SourceTree

ROOT = Path(__file__).parents[1]
TREE = SourceTree(ROOT)
LIBRARY = sorted(m for m in TREE.modules if m.startswith(PACKAGE) and not m.startswith(f"{PACKAGE}.study"))
DVC = yaml.safe_load((ROOT / "dvc.yaml").read_text("utf-8"))
STAGES = DVC["stages"]


def circle(edges: Mapping[str, frozenset[str]]) -> list[str]:
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


def tree_of(folder: Path, texts: Mapping[str, str]) -> SourceTree:
    """A package of the given files (``a/b`` is a/b.py) below ``folder``."""
    for name, text in texts.items():
        path = folder / "src" / PACKAGE / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (folder / "stages").mkdir()
    return SourceTree(folder)


@pytest.mark.parametrize("module", LIBRARY)
def test_the_library_imports_neither_the_study_nor_the_stages(module: str) -> None:
    wrong = sorted(m for m in TREE.edges[module] if m.startswith((f"{PACKAGE}.study", "stages")))
    assert not wrong, f"{module} imports {wrong}; move what it needs out of there"


def test_nothing_in_the_package_imports_the_stages() -> None:
    assert not [m for m, named in TREE.edges.items() if m.startswith(PACKAGE) and any(n[:6] == "stages" for n in named)]


#: Names of effects that are also the name of a parameter, a setting or a term of a file format.
WORDS_TOO = {"armature", "inertial_parameters", "position_offset", "torque_gain"}
#: Every effect of the catalogue.
KNOWN = catalogue(everything=True)
#: Library modules in which the name of an effect counts.
ROOMS = [
    p for p in sorted((ROOT / "src" / PACKAGE).rglob("*.py")) if p.parts[-2] != "effects" and "study" not in p.parts
]


def effects_named(text: str) -> list[str]:
    """Effects whose name decides something in the code ``text``; docstrings and examples in them do not count."""
    tree = ast.parse(text)
    decisive = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
            decisive |= {id(n) for side in sides for n in (side, *getattr(side, "elts", ()))}
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("Effect", "Term", "family"):
            decisive |= {id(n) for n in node.args}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and node.value in KNOWN
        and (node.value not in WORDS_TOO or id(node) in decisive)
    ]


@pytest.mark.parametrize("file", ROOMS, ids=lambda p: str(p.relative_to(ROOT / "src" / PACKAGE)))
def test_the_library_names_no_effect_outside_the_catalogue(file: Path) -> None:
    found = effects_named(file.read_text("utf-8"))
    assert not found, f"{file} decides by {found}; ask the family (effects/base.py) instead"


def test_a_named_effect_is_found_and_a_word_of_another_kind_is_not() -> None:
    assert effects_named('"""The payload."""\nif term.effect == "payload": pass') == ["payload"]
    assert effects_named('KINDS = {"stribeck_friction": 1}') == ["stribeck_friction"]
    assert effects_named('if term.effect in {"armature"}: pass') == ["armature"]
    assert effects_named('row = {"armature": robot.armature}') == []


def untold(folder: str, text: str) -> list[str]:
    """Modules and packages of ``folder`` that no table of ``text`` (docs/architecture.md) names as what it is about."""
    rows = re.findall(r"^\|([^|]*`[^|]*)\|", text[text.index("## Modules") :], re.M)
    about = {name for row in rows for name in re.findall(r"`([\w/]+)`", row)}
    paths = [p for p in (ROOT / "src" / PACKAGE / folder).iterdir() if p.suffix in ("", ".py") and p.name[:2] != "__"]
    return sorted({p.stem if p.is_file() else f"{p.name}/" for p in paths} - about)


@pytest.mark.parametrize("folder", ["", "loop", "study"])
def test_every_module_stands_in_the_architecture(folder: str) -> None:
    text = (ROOT / "docs/architecture.md").read_text("utf-8")
    assert untold(folder, text) == []
    # The control: one that is left out is named.
    assert untold("study", text.replace("`plausible`", "`feasible`")) == ["plausible"]


def test_no_files_import_one_another_in_a_circle() -> None:
    found = circle(TREE.edges)
    assert not found, " -> ".join(found)


def test_a_circle_is_found_also_where_a_function_hides_it(tmp_path: Path) -> None:
    hidden = "def f():\n    from hybrid_dynamics.c import x"
    tree = tree_of(tmp_path, {"a": "from hybrid_dynamics import b", "b": hidden, "c": "import hybrid_dynamics.a"})
    assert circle(tree.edges) == [f"{PACKAGE}.{name}" for name in "abca"]
    assert circle({**tree.edges, f"{PACKAGE}.c": frozenset()}) == []


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_declares_all_the_code_it_imports(stage: str) -> None:
    declared = [d for d in STAGES[stage]["deps"] if is_code(d)]
    missing = [d for d in code_of(stage, STAGES[stage], TREE) if d not in declared]
    assert not missing, f"stage {stage} imports {missing}; run make deps"
    gone = [d for d in declared if not (ROOT / d).exists()]
    assert not gone, f"stage {stage} depends on {gone}, which is not there; run make deps"


@pytest.mark.parametrize("stage", STAGES)
def test_no_stage_runs_again_because_the_command_line_changed(stage: str) -> None:
    assert not [d for d in STAGES[stage]["deps"] if d.startswith(f"src/{PACKAGE}/cli")]


def test_a_network_that_changed_trains_the_networks_alone() -> None:
    file = f"src/{PACKAGE}/models/network.py"
    readers = {name for name, stage in STAGES.items() if file in stage["deps"]}
    assert {name for name in readers if name.startswith(TRAIN)} == {"train_nn", "train_r_nn"}
    assert "evaluate" in readers


def test_what_a_stage_imports_is_followed_through_packages_stubs_and_folders(tmp_path: Path) -> None:
    tree = tree_of(
        tmp_path,
        {
            "lazy/__init__": "import lazy_loader",
            "lazy/one": "",
            "lazy/two": "",
            "folder/__init__": "import pkgutil\nnames = pkgutil.iter_modules(__path__)",
            "folder/found": "import hybrid_dynamics.deep",
            "deep": "",
            "unused": "",
            "top": "from hybrid_dynamics.lazy import name\nfrom hybrid_dynamics import folder",
        },
    )
    (tmp_path / "src" / PACKAGE / "lazy" / "__init__.pyi").write_text("from .one import name\n", encoding="utf-8")
    found = {m.removeprefix(f"{PACKAGE}.") for m in tree.closure([f"{PACKAGE}.top"])}
    assert found == {"top", "lazy", "lazy.one", "folder", "folder.found", "deep"}


def test_a_method_of_the_table_gets_its_stage() -> None:
    document = copy.deepcopy(DVC)
    del document["stages"]["train_r_nn"]
    document["stages"]["evaluate"]["deps"].remove("data/${item.dataset}/models/r_nn")

    class Ordered(dict):
        """A mapping with ruamel's ``insert``."""

        def insert(self, place: int, key: str, value: object) -> None:
            self[key] = value

    document["stages"] = Ordered(document["stages"])
    update(document, TREE)
    for key in ("cmd", "params", "outs", "matrix"):
        assert document["stages"]["train_r_nn"][key] == STAGES["train_r_nn"][key]
    assert set(document["stages"]["train_r_nn"]["deps"]) == set(STAGES["train_r_nn"]["deps"])
    assert set(document["stages"]["evaluate"]["deps"]) == set(STAGES["evaluate"]["deps"])


def test_every_method_has_its_stage() -> None:
    assert {f"{TRAIN}{name}" for name in layered()} <= set(STAGES)
