from .effects.base import Family
from .loop.close import LoopResult, close_loop
from .loop.diagnosis import Diagnosis
from .loop.model import Model, load_model
from .loop.prediction import predict
from .loop.settings import LoopSettings
from .readers.log import read_log
from .robots.robot import Robot

__all__ = [
    "Diagnosis",
    "Family",
    "LoopResult",
    "LoopSettings",
    "Model",
    "Robot",
    "close_loop",
    "load_model",
    "predict",
    "read_log",
]
