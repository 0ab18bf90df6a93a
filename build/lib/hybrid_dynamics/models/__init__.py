"""Torque models shaped like scikit-learn's: ``fit(X, y)``, ``predict(X)``, learned state in names that end in ``_``."""

import lazy_loader

# What the package offers stands in __init__.pyi, for readers, type checkers and the loader: scikit-learn, PySINDy and
# SymPy take seconds to import, and the loop needs little of them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
