"""Write into ``dvc.yaml`` what each stage imports, and a stage for every method of the table (``make deps``).

The dependencies on code are read from the source: a stage re-runs where a file it imports has changed, and only there.
Dependencies on data, params and outputs are written by hand.
"""

import sys
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.models.methods import METHODS, Method, is_reduced, layered
from hybrid_dynamics.study.imports import SourceTree

ROOT = Path(__file__).resolve().parents[1]
DATA = "data/${item.dataset}"
TRAIN = "train_"
STORAGE = "hybrid_dynamics.models.storage"


def code_of(stage: str, definition: dict[str, Any], tree: SourceTree) -> list[str]:
    """Files and folders of code that ``stage`` imports, from the program its command runs.

    Layers are imported by name when a model is built or read: a method's own chain by its training stage, any of them
    by other stages that read models.
    """
    program = str(definition["cmd"]).split()[2]
    modules = tree.closure([program])
    if stage.removeprefix(TRAIN) in layered():
        modules |= tree.closure(_chain(METHODS[stage.removeprefix(TRAIN)]))
    elif STORAGE in modules:
        modules |= tree.closure(m.layer.module for m in METHODS.values() if m.layer is not None)
    return tree.compact(tree.files(modules))


def _chain(method: Method) -> list[str]:
    """Modules of the layers of ``method``, from the top down."""
    below = _chain(METHODS[method.below]) if method.below is not None else []
    return [*([method.layer.module] if method.layer is not None else []), *below]


def training_stage(method: Method) -> CommentedMap:
    """The stage that trains ``method``, but for its code."""
    data = [f"{DATA}/{'factor.safetensors' if is_reduced(method.name) else 'features.parquet'}"]
    if method.learned_below is not None:
        data.append(f"{DATA}/models/{method.learned_below}")
    return CommentedMap(
        desc=method.what.rstrip("."),
        matrix={"dataset": "${datasets}"},
        cmd=f"python -m stages.train {method.name} ${{item.dataset}}",
        params=[method.section],
        deps=data,
        outs=[f"{DATA}/models/{method.name}", f"{DATA}/timing/{method.name}.json"],
    )


def is_code(dependency: str) -> bool:
    """Whether a dependency is written by this program."""
    return dependency.startswith(("src/", "stages/"))


def update(document: dict[str, Any], tree: SourceTree) -> None:
    """Bring ``document``, the content of dvc.yaml, up to date with the table of methods and the imports."""
    stages = document["stages"]
    for name in layered():
        if f"{TRAIN}{name}" not in stages:
            place = max(k for k, stage in enumerate(stages) if stage.startswith(TRAIN)) + 1
            stages.insert(place, f"{TRAIN}{name}", training_stage(METHODS[name]))
    evaluate = stages["evaluate"]["deps"]
    evaluate += [m for name in layered() if (m := f"{DATA}/models/{name}") not in evaluate]
    for name, stage in stages.items():
        data = [dependency for dependency in stage["deps"] if not is_code(dependency)]
        stage["deps"] = [*code_of(name, stage, tree), *data]


def main() -> None:
    yaml = YAML()
    yaml.width, yaml.preserve_quotes = 120, True
    yaml.indent(mapping=2, sequence=4, offset=2)
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "dvc.yaml"
    document = yaml.load(path.read_text("utf-8"))
    update(document, SourceTree(ROOT))
    with atomic_path(path) as temporary:
        yaml.dump(document, temporary)
    print(f"{path.name}: what {len(document['stages'])} stages import is up to date")


if __name__ == "__main__":
    run_main(main)
