"""A CasADi function for model-predictive control and optimisation, rigid body included."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as cs

from hybrid_dynamics.export.source import Rendered, Source


def function(source: Source) -> cs.Function:
    """``torque(q, dq, ddq[, state]) -> tau, tau_std, tau_rigid_body``, each (n,) [N m]."""
    model = source.symbolic
    arguments = list(model.inputs.values())
    own = arguments[:3]
    outputs = [model.torque(*arguments), model.deviation(*arguments), model.rigid_body(*own)]
    return cs.Function("torque", arguments, outputs, list(model.inputs), ["tau", "tau_std", "tau_rigid_body"])


def render(source: Source, name: str, head: list[str]) -> Rendered:
    """The function (read it with ``casadi.Function.load``) and the head beside it: the format has no room for one."""
    lines = [*head, "", f'f = casadi.Function.load("{name}"); f(q, dq, ddq) gives tau, tau_std, tau_rigid_body [N m].']
    lines.append(f"tau_std is the standard deviation of tau: {source.symbolic.deviation_words}.")
    with TemporaryDirectory() as folder:  # only CasADi's own writer makes what Function.load reads
        path = Path(folder) / "function.casadi"
        function(source).save(str(path))
        content = path.read_bytes()
    return Rendered({name: content, f"{name}.txt": "\n".join([*lines, ""]).encode()})
