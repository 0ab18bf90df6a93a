"""The loop: name what a model lacks (trace), add it (augment), until nothing is left; say what cannot be told."""

from hybrid_dynamics.loop.close import LoopResult, close_loop
from hybrid_dynamics.loop.diagnosis import write_diagnosis
from hybrid_dynamics.loop.model import Model, load_model, save_model
from hybrid_dynamics.loop.process import ProcessSettings, Run, process
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.settings import LoopSettings

__all__ = [
    "LoopResult",
    "LoopSettings",
    "Model",
    "ProcessSettings",
    "Run",
    "Step",
    "close_loop",
    "load_model",
    "process",
    "save_model",
    "write_diagnosis",
]
