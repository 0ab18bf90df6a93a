"""Runs that disagree: an effect fitted run by run, compared within its uncertainty, instead of averaged in silence.

A tool that was exchanged or turned between recordings makes held-out runs contradict each other, so that
cross-validation over runs finds no whole-robot effect at all. Where something stays unexplained, whole-robot effects
are therefore also tried with parameters of their own in every run, validated on parts of the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.identifiability import fit_alone
from hybrid_dynamics.loop.search import Step, search
from hybrid_dynamics.loop.trace import Judge, same_place
from hybrid_dynamics.types import Array

#: Of the excess over the floor, the share that parameters per run must remove before runs are said to disagree.
DECISIVE = 0.5
#: And how sure that must be, in standard errors.
SURE = 3.0


def parts_of(term: Term, names: Sequence[str]) -> list[Term]:
    """``term`` once for every run."""
    return [replace(term, settings=(*term.settings, (ONLY_RUN, name))) for name in names]


def whole_of(terms: Sequence[Term]) -> list[Term]:
    """What those of ``terms`` that act in one run only are parts of."""
    return list(dict.fromkeys(_whole(s) for s in terms if _whole(s) != s))


def _whole(term: Term) -> Term:
    return replace(term, settings=tuple(s for s in term.settings if s[0] != ONLY_RUN))


def split_by_run(
    judge: Judge, current: Sequence[Term], candidates: Sequence[Term], report: Callable[[Step], None]
) -> tuple[Judge, list[Step]]:
    """Steps of a search that starts from a whole-robot effect fitted per run, validated on parts of the runs, and the
    judge at its end; no steps, and ``judge``, where that is not called for."""
    evidence = judge.evidence
    if len(evidence.runs) < 2:
        return judge, []
    split = judge.over(evidence.fold_by_time())
    names = [run.name for run in evidence.runs]
    # What a flexible law made of the disagreement is not taken along.
    plain = [s for s in current if s.family().searched]
    joint_wise = [s for s in plain if s.family().scope == "joint"]
    samples = float(evidence.samples[evidence.samples >= FEWEST_ROWS].sum())
    best: tuple[float, list[Term]] | None = None
    for term in candidates:
        if term.family().scope != "robot":
            continue
        parts = parts_of(term, names)
        split = split.adding(parts)
        held = split.evidence.held
        others = [s for s in plain if not same_place(s, term)]
        for rest in ([], joint_wise, others):
            trial = held([*parts, *rest])
            pooled = held([term, *rest])
            for rival in (held(current), pooled):
                gain = split.gain(trial, rival)
                large = gain.total > DECISIVE * max(rival.score - samples, 0.0)
                if not (
                    large and gain.surer_than(SURE) and judge.matters(term, gain.per_joint, judge.settings.floor_share)
                ):
                    break
            else:
                if best is None or trial.score < best[0]:
                    best = trial.score, [*parts, *rest]
    if best is None:
        return judge, []
    return search(split, [c for c in candidates if c.family().searched], report, best[1])


def pool(judge: Judge, terms: Sequence[Term]) -> tuple[Judge, list[Term], Array]:
    """Terms with the parts of an effect merged, and coordinates: the others keep theirs, the merged one is refitted.
    And the judge who has their columns."""
    evidence = judge.evidence
    x = evidence.fit(terms)
    layout = evidence.layout(terms)
    merged: list[Term] = []
    values: list[Array] = []
    for term, start in zip(layout.terms, layout.starts, strict=True):
        whole = _whole(term)
        if whole in merged:
            continue
        merged.append(whole)
        values.append(x[start : start + term.size])
    evidence = evidence.adding(merged)
    out = np.concatenate(values)
    everything = np.ones(len(evidence.blocks.rows), bool)
    for term in whole_of(terms):
        start = evidence.layout(merged).starts[merged.index(term)]
        solution, _, _ = fit_alone(evidence, merged, out, term, start, everything)
        out[start : start + term.size] = solution
    return judge.over(evidence), merged, out
