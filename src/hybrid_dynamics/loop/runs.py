"""Runs that disagree: an effect fitted run by run, compared within its uncertainty, instead of averaged in silence.

A tool that was exchanged or turned between recordings makes held-out runs contradict each other, so that
cross-validation over runs finds no whole-robot effect at all. Where something stays unexplained, whole-robot effects
are therefore also tried with parameters of their own in every run, validated on parts of the runs. Of many runs those
that ask for alike parameters have them in common: what differs is a tool or two, and columns for every run would fill
any memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN, whole_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.identifiability import fit_alone
from hybrid_dynamics.loop.search import Step, search
from hybrid_dynamics.loop.trace import Judge, same_place
from hybrid_dynamics.loop.weighing import weighed_by
from hybrid_dynamics.types import Array

#: Of the excess over the floor, the share that parameters per run must remove before runs are said to disagree.
DECISIVE = 0.5
#: And how sure that must be, in standard errors.
SURE = 3.0
#: Groups of runs that have parameters of their own, at most.
MOST_GROUPS = 6


def parts_of(term: Term, groups: Sequence[Sequence[str]]) -> list[Term]:
    """``term`` once for each of the ``groups`` of runs, given by their names."""
    only = [names[0] if len(names) == 1 else tuple(names) for names in groups]
    return [replace(term, settings=(*term.settings, (ONLY_RUN, own))) for own in only]


def groups_of(evidence: Evidence, current: Sequence[Term], term: Term) -> list[list[str]]:
    """Names of the runs in which ``term`` beside ``current`` may have parameters of its own: every run, or equally many
    in each of :data:`MOST_GROUPS`, ordered by what each alone asks for along the direction in which they differ most.
    """
    names = [run.name for run in evidence.runs]
    if len(names) <= MOST_GROUPS:
        return [[name] for name in names]
    terms = [*(t for t in current if t != term), term]
    layout = evidence.layout(terms)
    x, own = evidence.fit(terms), np.arange(layout.starts[-1], layout.total)
    asked = [fit_alone(evidence, terms, x, own, evidence.blocks.run == r)[0] for r in range(len(names))]
    away = (np.array(asked) - np.mean(asked, axis=0)) / term.prior_scale(evidence.robot)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    return [
        [names[r] for r in sorted(group)] for group in np.array_split(np.argsort(along, kind="stable"), MOST_GROUPS)
    ]


def wholes_of(terms: Sequence[Term]) -> list[Term]:
    """What those of ``terms`` that act in some runs only are parts of."""
    return list(dict.fromkeys(whole_of(s) for s in terms if whole_of(s) != s))


def split_by_run(
    judge: Judge, current: Sequence[Term], candidates: Sequence[Term], report: Callable[[Step], None]
) -> tuple[Judge, list[Step]]:
    """Steps of a search that starts from a whole-robot effect fitted per run, validated on parts of the runs, and the
    judge at its end; no steps, and ``judge``, where that is not called for."""
    strict = _who_sees_more(judge, current)
    if strict is None:
        return judge, []
    evidence = strict.evidence
    split = best_judge = strict.over(evidence.fold_by_time())
    # What a flexible law made of the disagreement is not taken along.
    plain = [s for s in current if s.family().searched]
    joint_wise = [s for s in plain if s.family().scope == "joint"]
    samples = float(evidence.samples[evidence.samples >= FEWEST_ROWS].sum())
    best: tuple[float, list[Term]] | None = None
    for term in candidates:
        # A tool, a mounting, a delay may be another from one recording to the next; all links never are.
        if term.family().scope != "robot" or term.family().all_links:
            continue
        split = split.adding([term])
        parts = parts_of(term, groups_of(split.evidence, current, term))
        # Products of the other terms' parts are not kept: they would be most of the memory.
        own_judge = split.adding(parts)
        held = own_judge.evidence.held
        others = [s for s in plain if not same_place(s, term)]
        for rest in ([], joint_wise, others):
            trial = held([*parts, *rest])
            pooled = held([term, *rest])
            for rival in (held(current), pooled):
                gain = own_judge.gain(trial, rival)
                large = gain.total > DECISIVE * max(rival.score - samples, 0.0)
                felt = strict.matters(term, gain.per_joint, strict.settings.floor_share)
                if not (large and felt and gain.surer_than(SURE)):
                    break
            else:
                if best is None or trial.score < best[0]:
                    best, best_judge = (trial.score, [*parts, *rest]), own_judge
    if best is None:
        return judge, []
    if strict is not judge:
        # What a law for every run leaves is the floor from here on, not what no law leaves.
        left = np.sqrt(best_judge.mean_square(best_judge.evidence.held(best[1])))
        best_judge = weighed_by(best_judge, np.where(strict.floor > 0, np.clip(left, strict.floor, judge.floor), 0.0))
    return search(best_judge, [c for c in candidates if c.family().searched], report, best[1])


def _who_sees_more(judge: Judge, current: Sequence[Term]) -> Judge | None:
    """``judge`` where ``current`` leaves more than the floor on a joint of several runs; None where nobody sees more.

    A rich model fitted to runs that disagree leaves that on top of the noise, and its floor hides what is looked for.
    Second differences know no model: where the floor is much above theirs, who takes theirs has the say.
    """
    if len(judge.evidence.runs) < 2:
        return None
    lowest = weighed_by(judge, np.where(judge.floor > 0, np.minimum(judge.low, judge.floor), 0.0))
    for one in (judge, lowest):
        if one.above_floor(one.evidence.held(current, physical=True)).any():
            return one
    return None


def pool(judge: Judge, terms: Sequence[Term]) -> tuple[Judge, list[Term], Array]:
    """Terms with the parts of an effect merged, and coordinates: the others keep theirs, the merged one is refitted.
    And the judge who has their columns."""
    evidence = judge.evidence
    x = evidence.fit(terms)
    layout = evidence.layout(terms)
    merged: list[Term] = []
    values: list[Array] = []
    for term, start in zip(layout.terms, layout.starts, strict=True):
        whole = whole_of(term)
        if whole in merged:
            continue
        merged.append(whole)
        values.append(x[start : start + term.size])
    evidence = evidence.adding(merged)
    out = np.concatenate(values)
    everything = np.ones(len(evidence.blocks.rows), bool)
    for term in wholes_of(terms):
        start = evidence.layout(merged).starts[merged.index(term)]
        own = np.arange(start, start + term.size)
        out[own], _, _ = fit_alone(evidence, merged, out, own, everything)
    return judge.over(evidence), merged, out
