"""Columns that belong to other joints, told from joints that are coupled: one's torque follows the other's motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hybrid_dynamics.check.columns import Columns
from hybrid_dynamics.check.cures import exchanged, reordered
from hybrid_dynamics.check.findings import Finding, Severity
from hybrid_dynamics.check.guess import CHANGED, EXPLAINED, SETTLED, UNEXPLAINED, Guess, is_certain, left_of, shares_of
from hybrid_dynamics.check.pulled import coupling_leaves

#: Why a reading of joints that :func:`places` is told show nothing is in doubt.
ONE_WAY = "of joints that move one way any torque that rises or falls looks the same"


def places(
    names: Sequence[str], told: Guess, best: Guess, columns: Columns, shows: Callable[[int], bool] = lambda j: True
) -> list[Finding]:
    """Columns that belong to other joints.

    ``shows(j)``: whether joint ``j``, as ``best`` reads it, moves so that its torque can be told from others: along one
    way friction is a constant and a slope, and so is what any joint lacks.
    """
    moved = [j for j, k in enumerate(best.source) if j != k]
    pair = best.swap if best.swap is not None else tuple(moved)
    # Another order that leaves much itself may be no more than nearer to a law that joints share.
    explained = all(left_of(best.scores[j]) < UNEXPLAINED for j in pair)
    shown = all(shows(j) for j in pair)
    severity: Severity = "hard" if explained and shown and is_certain(told, best) else "warning"
    if len(pair) == 2 and _coupled(told, best, columns, pair):
        one, other = (names[j] for j in pair)
        text = (
            f"it looks as if columns of {one} and {other} were exchanged ({shares_of(told, best, pair)}); torque of "
            "one that follows the motion of both leaves as little: close-loop names it joint_coupling; if the columns' "
            "order is in doubt, exchange them and check again"
        )
        return [Finding("joint_order", "warning", text, joint=one)]
    if best.swap is not None:
        return [_exchanged(names, told, best, best.swap, severity, shown)]
    if not moved:
        return []
    pairs = "; ".join(f"tau{best.source[j] + 1} fits the motion of {names[j]}" for j in moved)
    text = (
        f"torque and position columns do not belong together: {pairs} ({shares_of(told, best, moved)}); expected both "
        "in the order of the URDF's joints: exchange the columns"
    )
    if not shown:
        text = f"it looks as if {text}; {ONE_WAY}"
    cure = reordered(best.source, ["tau"]) if shown else {}
    return [Finding("joint_order", severity, text, joint=names[moved[0]], suggestion=cure)]


def _coupled(told: Guess, best: Guess, columns: Columns, pair: tuple[int, ...]) -> bool:
    """Whether one of ``pair`` is explained as it stands, and the other by a coupling to it as well as by an exchange.

    Of columns that are exchanged neither is.
    """
    strange = [j for j in pair if left_of(told.scores[j]) >= EXPLAINED]
    if len(strange) != 1:
        return False
    (j,) = strange
    (k,) = (k for k in pair if k != j)
    return coupling_leaves(columns, told.gravity, j, k) <= max(left_of(best.scores[j]), SETTLED)


def _exchanged(
    names: Sequence[str], told: Guess, best: Guess, pair: tuple[int, int], severity: Severity, shown: bool
) -> Finding:
    """Positions of ``pair`` exchanged: certain only where both joints' torques say so.

    One joint that goes with the other's motion may as well be coupled to it, where the other's own torque is silent.
    """
    a, b = pair
    moved = any(j != k for j, k in enumerate(best.source))
    what = "positions and torques" if moved else "positions"
    changed = [j for j, (x, y) in enumerate(zip(told.scores, best.scores, strict=True)) if x - y > CHANGED] or [a, b]
    silent = [j for j in pair if left_of(best.scores[j]) >= EXPLAINED]
    shares = shares_of(told, best, changed)
    if silent:
        text = (
            f"the {what} of {names[a]} and {names[b]} may be exchanged ({shares}), but the torque of "
            f"{names[silent[0]]} says nothing of it: joints that turn with each other look the same, which close-loop "
            "names joint_coupling; if the columns' order is in doubt, exchange them and check again"
        )
        return Finding("joint_order", "warning", text, joint=names[a])
    text = (
        f"the {what} of {names[a]} and {names[b]} are exchanged ({shares}); expected the columns in the order of the "
        "URDF's joints: exchange the columns"
    )
    if not shown:
        text = f"it looks as if {text}; {ONE_WAY}"
    cure = reordered(exchanged(len(names), a, b), ["q", "dq", "tau"] if moved else ["q", "dq"]) if shown else {}
    return Finding("joint_order", severity, text, joint=names[a], suggestion=cure)
