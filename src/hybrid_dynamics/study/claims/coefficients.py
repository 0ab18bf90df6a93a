"""Table III: which terms each closed-form model holds, and its coefficients against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hybrid_dynamics.study.claims import paper
from hybrid_dynamics.study.expressions import LONGEST, number_of_terms, terms
from hybrid_dynamics.study.methods import TORQUE_EXPRESSIONS, in_order
from hybrid_dynamics.study.results import DatasetResults

RIGID_BODY = ("tau_inertia", "tau_coriolis", "tau_gravity")


@dataclass(frozen=True)
class JointTerms:
    """The terms of one method's expression of one joint beside the true ones.

    ``found`` is None for an expression too long to be expanded (``count`` terms). ``truth`` maps the true terms to
    their coefficients; ``missing`` and ``extra`` are the differences of the two sets.
    """

    method: str
    joint: int
    expression: str
    count: int
    found: dict[str, float] | None
    truth: dict[str, float]
    paper: dict[str, float]

    @property
    def missing(self) -> tuple[str, ...]:
        """True terms that were not found."""
        return tuple(term for term in self.truth if self.found is not None and term not in self.found)

    @property
    def extra(self) -> tuple[str, ...]:
        """Terms that are not true."""
        return tuple(term for term in self.found or {} if term not in self.truth)

    @property
    def exact(self) -> bool:
        """Exactly the true terms and no other."""
        return self.found is not None and not self.missing and not self.extra

    def relative_error(self, term: str) -> float | None:
        """|found / true - 1| of a true term; None where it was not found."""
        if self.found is None or term not in self.found:
            return None
        return abs(self.found[term] / self.truth[term] - 1.0)


def true_terms(results: DatasetResults, method: str, joint: int, damping: float) -> dict[str, float]:
    """Terms of the simulated arm's torque (or residual) of ``joint``; identically zero torques have no coefficient."""
    out: dict[str, float] = {}
    if method in TORQUE_EXPRESSIONS:
        names = (f"{name}{joint}" for name in RIGID_BODY)
        out = {name: 1.0 for name in names if name not in results.zero_torques}
    return {**out, f"dq{joint}": damping}


def damping_of(results: DatasetResults) -> tuple[float, ...] | None:
    """Viscous damping [N m s/rad] the data was simulated with (metadata ``damping``, else the paper's for panda)."""
    if "damping" in results.metadata:
        return tuple(float(value) for value in results.metadata["damping"])
    return paper.PANDA_DAMPING if results.name == "panda" and results.n_joints == 7 else None


def table_three(results: DatasetResults) -> Iterator[JointTerms]:
    """One entry per method with expressions and joint; nothing for a dataset whose true damping is not known."""
    damping = damping_of(results)
    if damping is None:
        return
    for method in in_order(results.expressions["method"]):
        column = paper.COUNTERPART.get(method, method)
        if column not in paper.TABLE_III:
            continue
        rows = results.expressions[results.expressions["method"] == method]
        counterpart = paper.TABLE_III[column]
        for row in rows.sort_values("joint").to_dict("records"):
            joint, expression = int(row["joint"]), str(row["expression"])
            short = len(expression) <= LONGEST
            found = terms(expression) if short else None
            yield JointTerms(
                method,
                joint,
                expression,
                len(found) if found is not None else number_of_terms(expression),
                found,
                true_terms(results, method, joint, damping[joint - 1]),
                dict(counterpart.get(joint, {})),
            )
