"""Estimators on disk: ``model.json`` and, for networks, ``weights.safetensors``. No pickle, nothing is evaluated.

A model read back predicts the same numbers to the last bit on the same machine.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.files import atomic_path, write_json
from hybrid_dynamics.models.base import Estimator, HybridEstimator, RigidBody
from hybrid_dynamics.models.expressions import canonical, format_expression, parse_expression
from hybrid_dynamics.models.network import NetworkEstimator, NetworkSettings
from hybrid_dynamics.models.sindy import SindyEstimator, SindySettings
from hybrid_dynamics.models.symbolic import FrontRow, SymbolicEstimator, SymbolicSettings

SCHEMA = 1
MODEL_FILE = "model.json"
WEIGHTS_FILE = "weights.safetensors"

Weights = dict[str, NDArray[np.float32]]


def save_estimator(estimator: Estimator, folder: str | os.PathLike[str]) -> None:
    """Write a fitted ``estimator`` into ``folder`` (created where needed). Same model, same bytes."""
    weights: Weights = {}
    document = {"schema": SCHEMA, "model": _dump(estimator, weights, "model")}
    path = Path(folder) / WEIGHTS_FILE
    if weights:
        with atomic_path(path) as temporary:
            save_file(weights, temporary)
    else:
        path.unlink(missing_ok=True)
    write_json(Path(folder) / MODEL_FILE, document)


def load_estimator(folder: str | os.PathLike[str]) -> Estimator:
    """Read what :func:`save_estimator` wrote; raises :class:`InputError` naming the file and what is wrong with it."""
    path = Path(folder) / MODEL_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; train the method first (dvc repro)") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable model ({error})") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{path}: schema is {schema!r}; expected {SCHEMA}; train the method again")
    weights_path = Path(folder) / WEIGHTS_FILE
    try:
        weights = load_file(weights_path) if weights_path.exists() else {}
        return _load(document["model"], weights)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, SafetensorError) as error:
        raise InputError(f"{path}: the model is damaged ({type(error).__name__}: {error}); train it again") from None


def _dump(estimator: Estimator, weights: Weights, path: str) -> dict[str, Any]:
    if isinstance(estimator, HybridEstimator):
        return {
            "kind": "hybrid",
            "base": _dump(estimator.base, weights, f"{path}.base"),
            "residual": _dump(estimator.residual, weights, f"{path}.residual"),
        }
    if isinstance(estimator, RigidBody):
        return {"kind": "rigid_body", "joints": estimator.n_joints_}
    if isinstance(estimator, SindyEstimator):
        return _dump_sindy(estimator)
    if isinstance(estimator, SymbolicEstimator):
        return _dump_symbolic(estimator)
    if isinstance(estimator, NetworkEstimator):
        weights.update({f"{path}.{name}": value for name, value in estimator.weights_.items()})
        return {
            "kind": "network",
            "joints": estimator.n_joints_,
            "settings": asdict(estimator.settings or NetworkSettings()),
            "weights": path,
            "layers": list(estimator.weights_),
            "losses": estimator.losses_,
        }
    raise InputError(f"{type(estimator).__name__} has no stored form; expected one of {', '.join(_LOADERS)}")


def _dump_sindy(estimator: SindyEstimator) -> dict[str, Any]:
    names = estimator.term_names()
    terms = [[{"term": names[k], "coefficient": float(row[k])} for k in np.flatnonzero(row)] for row in estimator.coef_]
    return {
        "kind": "sindy",
        "joints": estimator.n_joints_,
        "settings": asdict(estimator.settings or SindySettings()),
        "converged": estimator.converged_,
        "terms": terms,
    }


def _dump_symbolic(estimator: SymbolicEstimator) -> dict[str, Any]:
    return {
        "kind": "symbolic",
        "joints": estimator.n_joints_,
        "settings": asdict(estimator.settings or SymbolicSettings()),
        "expressions": [format_expression(expression) for expression in estimator.expressions_],
        "shares_explained": list(estimator.shares_explained_),
        "front": [row.as_dict() for row in estimator.front_],
    }


def _load(node: dict[str, Any], weights: Weights) -> Estimator:
    kind = node["kind"]
    if kind not in _LOADERS:
        raise ValueError(f"kind is {kind!r}; expected one of {', '.join(_LOADERS)}")
    return _LOADERS[kind](node, weights)


def _load_hybrid(node: dict[str, Any], weights: Weights) -> Estimator:
    hybrid = HybridEstimator(_load(node["base"], weights), _load(node["residual"], weights))
    hybrid.n_joints_ = hybrid.base.n_joints_  # type: ignore[attr-defined]
    return hybrid


def _load_rigid_body(node: dict[str, Any], weights: Weights) -> Estimator:
    rigid = RigidBody()
    rigid.n_joints_ = int(node["joints"])
    return rigid


def _load_sindy(node: dict[str, Any], weights: Weights) -> Estimator:
    estimator = SindyEstimator(SindySettings(**node["settings"]))
    terms = [[(str(t["term"]), float(t["coefficient"])) for t in joint] for joint in node["terms"]]
    estimator.set_terms(terms, bool(node["converged"]))
    return estimator


def _load_symbolic(node: dict[str, Any], weights: Weights) -> Estimator:
    estimator = SymbolicEstimator(SymbolicSettings(**node["settings"]))
    names = feature_names(int(node["joints"]))
    estimator.set_expressions([canonical(parse_expression(str(text), names), names) for text in node["expressions"]])
    estimator.shares_explained_ = tuple(float(share) for share in node["shares_explained"])
    estimator.front_ = tuple(FrontRow(**row) for row in node["front"])
    return estimator


def _load_network(node: dict[str, Any], weights: Weights) -> Estimator:
    estimator = NetworkEstimator(NetworkSettings(**node["settings"]))
    estimator.n_joints_ = int(node["joints"])
    estimator.weights_ = {name: weights[f"{node['weights']}.{name}"] for name in node["layers"]}
    estimator.losses_ = [float(loss) for loss in node["losses"]]
    return estimator


_LOADERS: dict[str, Callable[[dict[str, Any], Weights], Estimator]] = {
    "hybrid": _load_hybrid,
    "rigid_body": _load_rigid_body,
    "sindy": _load_sindy,
    "symbolic": _load_symbolic,
    "network": _load_network,
}
