"""Compose ``conf/`` into ``params.yaml``, exactly as ``dvc exp run`` does (arguments are Hydra overrides).

A setting that the library has and its file in ``conf/`` lacks is first written there with its default: every number
that shapes the study can be seen and overridden (`dvc exp run -S`). What stands there is never changed. The group of a
method of the table that ``conf/config.yaml`` does not name yet is named there, and so is a data set: its own file says
under ``studies`` in which lists of ``conf/study/`` it stands. The full blind study hides every family of the catalogue.
"""

import sys
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dvc.utils.hydra import compose_and_dump
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from hybrid_dynamics.differentiate.registry import DIFFERENTIATORS
from hybrid_dynamics.differentiate.settings import ZOH, DifferentiateSettings
from hybrid_dynamics.effects import catalogue, family
from hybrid_dynamics.errors import ConfigError, run_main
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.identification.least_squares import LeastSquaresSettings
from hybrid_dynamics.loop.settings import LoopSettings
from hybrid_dynamics.models.methods import METHODS
from hybrid_dynamics.models.symbolic.settings import SymbolicSettings
from hybrid_dynamics.readers.ur10e import Ur10eSettings
from hybrid_dynamics.simulation.controller import ControllerSettings
from hybrid_dynamics.simulation.references import ReferenceSettings
from hybrid_dynamics.simulation.rollout import SimulationSettings
from hybrid_dynamics.simulation.sensors import SensorSettings
from hybrid_dynamics.study.blind import BlindSettings
from hybrid_dynamics.study.evaluation import EvaluationSettings

ROOT = Path(__file__).resolve().parents[1]
CONFIG = "config.yaml"
#: How a data set is named among the defaults of ``conf/config.yaml``.
DATASET = "dataset@dataset."
#: The study that hides every family.
EVERY_FAMILY = "blind/full.yaml"
#: The file of a layer's group that the study begins with, where it is not ``default.yaml``.
LAYER_FILES = {"sr": "operon", "sindy": "published", "sindy_scaled": "scaled", "nn": "paper"}


def plain(settings: Any) -> dict[str, Any]:
    """A settings dataclass as YAML knows it: mappings, lists, numbers, text."""
    return {name: _plain(value) for name, value in asdict(settings).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def defaults() -> dict[str, dict[str, Any]]:
    """File below ``conf/`` -> every setting that has its default there."""
    simulation = {
        "rollout": plain(SimulationSettings()),
        "reference": plain(ReferenceSettings()),
        "controller": plain(ControllerSettings()),
    }
    layers = {m.layer.section: m.layer for m in METHODS.values() if m.layer is not None}
    return {
        "loop/default.yaml": plain(LoopSettings()),
        "least_squares/default.yaml": plain(LeastSquaresSettings()),
        "sr/pysr.yaml": plain(SymbolicSettings(engine="pysr")),
        "evaluate/default.yaml": plain(EvaluationSettings()),
        "blind/default.yaml": plain(BlindSettings()),
        "simulation/default.yaml": simulation,
        "twin/default.yaml": {**simulation, "sensors": plain(SensorSettings()), "follow": [], "follow_period": 1e-3},
        "reader/ur10e.yaml": {"format": "ur10e", "ur10e": plain(Ur10eSettings())},
        **{f"differentiate/{name}.yaml": plain(DifferentiateSettings(name)) for name in (ZOH, *DIFFERENTIATORS)},
    } | {f"{name}/{LAYER_FILES.get(name, 'default')}.yaml": plain(layer.settings()) for name, layer in layers.items()}


#: Settings that another group of ``conf/`` holds.
ELSEWHERE = {"sr/operon.yaml": ("operators",), "sr/pysr.yaml": ("operators",)}


def missing(present: Mapping[str, Any], wanted: Mapping[str, Any], path: str = "") -> list[str]:
    """Dotted names of ``wanted`` that ``present`` lacks."""
    out = []
    for name, value in wanted.items():
        if name not in present:
            out.append(f"{path}{name}")
        elif isinstance(value, Mapping) and isinstance(present[name], Mapping):
            out += missing(present[name], value, f"{path}{name}.")
    return out


def complete(conf: Path) -> list[str]:
    """Write into ``conf`` what its files lack; returns what was added."""
    told = studies(conf)
    _check_lists(conf, told)
    yaml, added = YAML(), []
    yaml.width, yaml.preserve_quotes = 120, True
    yaml.indent(mapping=2, sequence=4, offset=2)
    for name, wanted in defaults().items():
        path = conf / name
        document = (yaml.load(path.read_text("utf-8")) if path.is_file() else None) or CommentedMap()
        wanted = {key: value for key, value in wanted.items() if key not in ELSEWHERE.get(name, ())}
        lacking = missing(document, wanted)
        if not lacking:
            continue
        _fill(document, wanted)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            yaml.dump(document, temporary)
        added += [f"conf/{name}: {key}" for key in lacking]
    path = conf / CONFIG
    document = yaml.load(path.read_text("utf-8"))
    groups = unnamed(document["defaults"])
    for name in groups:
        # Behind the groups of the other layers: what stands below may override them.
        _insert(
            document["defaults"], lambda entry: _group(entry) in _sections(), {name: LAYER_FILES.get(name, "default")}
        )
    named = {_group(entry) for entry in document["defaults"]}
    sets = [name for name in told if f"{DATASET}{name}" not in named]
    for name in sets:
        _insert(document["defaults"], lambda entry: _group(entry).startswith(DATASET), {f"{DATASET}{name}": name})
    if groups or sets:
        with atomic_path(path) as temporary:
            yaml.dump(document, temporary)
    added += [f"conf/{CONFIG}: {name}" for name in (*groups, *sets)]
    return added + _listed(conf, told, yaml) + _hidden(conf, yaml)


def studies(conf: Path) -> dict[str, dict[str, list[str]]]:
    """Data set -> study -> the lists of ``conf/study/<study>.yaml`` that its own file wants it in."""
    files = sorted((conf / "dataset").glob("*.yaml"))
    return {file.stem: told for file in files if (told := YAML().load(file.read_text("utf-8")).get("studies"))}


def _check_lists(conf: Path, told: Mapping[str, Mapping[str, Sequence[str]]]) -> None:
    """Raise :class:`ConfigError` for a study or a list that a data set names and that is not there: before anything is
    written."""
    for name, wanted in told.items():
        for study, groups in wanted.items():
            path = conf / "study" / f"{study}.yaml"
            if not path.is_file():
                known = ", ".join(sorted(file.stem for file in path.parent.glob("*.yaml")))
                raise ConfigError(f"conf/dataset/{name}.yaml: studies name {study!r}; conf/study/ has {known}")
            document = YAML().load(path.read_text("utf-8"))
            lists = [key for key, value in document.items() if isinstance(value, list) and key != "defaults"]
            for group in groups:
                if group not in lists:
                    raise ConfigError(
                        f"conf/dataset/{name}.yaml: {path.name} has no list {group!r}; it has {', '.join(lists)}"
                    )


def _listed(conf: Path, told: Mapping[str, Mapping[str, Sequence[str]]], yaml: YAML) -> list[str]:
    """Put every data set into the lists it wants to stand in, behind what stands there; returns what was added."""
    added: list[str] = []
    for study in sorted({study for wanted in told.values() for study in wanted}):
        path = conf / "study" / f"{study}.yaml"
        document, before = yaml.load(path.read_text("utf-8")), len(added)
        for name, wanted in told.items():
            for group in wanted.get(study, ()):
                if name not in document[group]:
                    document[group].append(name)
                    added.append(f"conf/study/{path.name}: {name} under {group}")
        if len(added) > before:
            with atomic_path(path) as temporary:
                yaml.dump(document, temporary)
    return added


def _hidden(conf: Path, yaml: YAML) -> list[str]:
    """Put every family that the full blind study does not hide yet among those it does, in the order of their names;
    returns what was added."""
    path = conf / EVERY_FAMILY
    document = yaml.load(path.read_text("utf-8"))
    families = document["blind"]["families"]
    new = [name for name in catalogue(everything=True) if family(name).hidden and name not in families]
    if new:
        for name in new:
            families.insert(sum(known < name for known in families), name)
        with atomic_path(path) as temporary:
            yaml.dump(document, temporary)
    return [f"conf/{EVERY_FAMILY}: {name} under families" for name in new]


def _insert(entries: list[Any], alike: Callable[[Any], bool], entry: dict[str, str]) -> None:
    """Put ``entry`` behind the last of ``entries`` that is ``alike``."""
    entries.insert(max(k for k, known in enumerate(entries) if alike(known)) + 1, entry)


def unnamed(entries: Sequence[Any]) -> list[str]:
    """Sections of layers whose group does not stand among ``entries``, the defaults of ``conf/config.yaml``."""
    known = {_group(entry) for entry in entries}
    return [name for name in _sections() if name not in known]


def _sections() -> list[str]:
    return list(dict.fromkeys(m.layer.section for m in METHODS.values() if m.layer is not None))


def _group(entry: Any) -> str:
    return str(next(iter(entry))) if isinstance(entry, Mapping) else str(entry)


def _fill(document: MutableMapping[str, Any], wanted: Mapping[str, Any]) -> None:
    for name, value in wanted.items():
        if isinstance(value, Mapping):
            _fill(document.setdefault(name, CommentedMap()), value)
        elif name not in document:
            document[name] = _flow(value) if isinstance(value, list) else value


def _flow(values: list[Any]) -> CommentedSeq:
    out = CommentedSeq(values)
    out.fa.set_flow_style()
    return out


def compose(output: Path, overrides: list[str], conf: Path = ROOT / "conf") -> None:
    """Write the composition of ``conf`` with ``overrides`` to ``output``."""
    try:
        with atomic_path(output) as temporary:
            compose_and_dump(temporary, str(conf), None, "config", str(ROOT), overrides)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"conf/: cannot be composed: {error}") from None


def main() -> None:
    for line in complete(ROOT / "conf"):
        print(f"{line}: written")
    compose(ROOT / "params.yaml", sys.argv[1:])
    print("params.yaml composed from conf/")


if __name__ == "__main__":
    run_main(main)
