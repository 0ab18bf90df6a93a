"""Estimators on disk: ``model.json`` and, for networks, ``weights.safetensors``. No pickle, nothing is evaluated.

A model read back predicts the same numbers to the last bit on the same machine.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from hybrid_dynamics.errors import InputError
from hybrid_dynamics.files import atomic_path, write_json
from hybrid_dynamics.models.base import Estimator, HybridEstimator, RigidBody, Weights
from hybrid_dynamics.models.methods import METHODS, layer_of_kind

SCHEMA = 1
MODEL_FILE = "model.json"
WEIGHTS_FILE = "weights.safetensors"


def save_estimator(estimator: Estimator, folder: str | os.PathLike[str]) -> None:
    """Write a fitted ``estimator`` into ``folder`` (created where needed). Same model, same bytes."""
    weights: Weights = {}
    document = {"schema": SCHEMA, "model": _dump(estimator, weights, "model")}
    path = Path(folder) / WEIGHTS_FILE
    if weights:
        # safetensors writes an array's memory: one stored by columns would come back with its values exchanged.
        rows = {name: np.ascontiguousarray(values) for name, values in weights.items()}
        with atomic_path(path) as temporary:
            # Its own save_file makes a file that nobody else on the machine can read.
            temporary.write_bytes(save(rows))
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
    document = getattr(estimator, "document", None)
    if document is None:
        raise InputError(f"{type(estimator).__name__} has no stored form; give it the methods of LayerEstimator")
    return dict(document(weights, path))


def _load(node: dict[str, Any], weights: Weights) -> Estimator:
    kind = node["kind"]
    if kind == "hybrid":
        hybrid = HybridEstimator(_load(node["base"], weights), _load(node["residual"], weights))
        hybrid.n_joints_ = hybrid.base.n_joints_  # type: ignore[attr-defined]
        return hybrid
    if kind == "rigid_body":
        rigid = RigidBody()
        rigid.n_joints_ = int(node["joints"])
        return rigid
    layer = layer_of_kind(kind)
    if layer is None:
        known = {m.layer.kind for m in METHODS.values() if m.layer is not None}
        raise ValueError(f"kind is {kind!r}; expected hybrid, rigid_body or one of {', '.join(sorted(known))}")
    return layer.estimator().from_document(node, weights)
