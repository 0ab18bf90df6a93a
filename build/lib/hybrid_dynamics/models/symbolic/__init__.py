"""Symbolic regression: two engines behind one interface, constants re-fitted, small terms dropped, the front kept."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # from __init__.pyi, loaded when used
