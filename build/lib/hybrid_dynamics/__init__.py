"""Interpretable hybrid robot dynamics: torque = rigid body + residual, and the physical effect behind the residual.

The names that others may rely on stand in ``__init__.pyi``; everything else may move. They are imported when they are
first used, so that ``import hybrid_dynamics`` costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
