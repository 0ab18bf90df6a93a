"""Taking a completed model away: into a URDF, a simulator, a controller, an optimiser. One module a format.

Only the table of formats stands here, so that asking for help costs no import; see :mod:`.writing` for the rest.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """Module that renders it, file endings, and the extra that brings the library it needs."""

    module: str
    endings: tuple[str, ...]
    extra: str = "export"


#: Learned methods are exported to this one, closed loops to the others.
NETWORK = "onnx"
FORMATS: dict[str, Format] = {
    "urdf": Format("urdf", (".urdf",)),
    "mjcf": Format("mjcf", (".xml", ".mjcf")),
    "c": Format("c_source", (".c",)),
    "python": Format("python_source", (".py",)),
    "casadi": Format("casadi_function", (".casadi",)),
    NETWORK: Format("onnx_graph", (".onnx",), NETWORK),
}
