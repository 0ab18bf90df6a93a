"""What the data cannot tell: explanations as good as the one named, parameters left open, runs that disagree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term, family
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.state import Equivalence
from hybrid_dynamics.loop.augment import effects_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.floor import FEWEST_ROWS
from hybrid_dynamics.loop.forms import forms_as_good
from hybrid_dynamics.loop.likeness import LIKENESS_OF_PAIR, Likeness, Place, pairs
from hybrid_dynamics.loop.trace import Judge, covers, same_place
from hybrid_dynamics.types import Array

#: A rival must be able to make at least this share of the effect's torque by itself.
LIKENESS = 0.3
#: Parameters of two runs that differ by less than this share are the same: drive gains are no better known.
DIFFERENCE = 0.05


def indistinguishable(
    judge: Judge, terms: Sequence[Term], candidates: Sequence[Term]
) -> dict[Term, list[dict[str, Any]]]:
    """What would explain as much in the place of each term (one candidate, or two together), why, and the remedy."""
    evidence = judge.evidence
    names = evidence.robot.joint_names
    forms = {term: _other_forms(judge, terms, term) for term in terms}
    full = evidence.held(terms, evidence.constrained(terms))
    x = evidence.fit(terms)
    layout = evidence.layout(terms)
    free = [c for c in candidates if not any(same_place(c, s) or covers(s, c) for s in terms)]
    out: dict[Term, list[dict[str, Any]]] = {}
    for term, start in zip(layout.terms, layout.starts, strict=True):
        likeness = Likeness(evidence, term, x[start : start + term.size])
        found: dict[frozenset[Place], tuple[float, dict[str, Any]]] = {}
        rest = [s for s in terms if s != term]
        active = evidence.constrained(rest)
        tried: set[frozenset[Place]] = set()
        for group in [*((c,) for c in free), *pairs(term, free)]:
            key = frozenset((c.effect, c.joint) for c in group)
            if (active and key in tried) or any(smaller < key for smaller in found):
                continue
            tried.add(key)
            share = likeness.share(*group)
            if share < (LIKENESS if len(group) == 1 else LIKENESS_OF_PAIR):
                continue
            held = evidence.held([*rest, *group], active)
            gain = judge.gain(held, full)
            loss, error = -gain.total, gain.error
            growth = judge.mean_square(held) / np.maximum(judge.mean_square(full), 1e-300) - 1
            growth = growth[evidence.samples >= FEWEST_ROWS]
            close = bool(np.all(growth < judge.settings.alike_share))
            # A whole body in place of one coefficient is no rival unless it predicts held-out runs as well.
            if not close and not (loss <= error and bool(np.all(growth < 5 * judge.settings.alike_share))):
                continue
            same = share > 1 - 1e-6
            worst = 100 * float(np.max(growth))
            why = (
                "the same torque in every sample of these runs"
                if same
                else f"held-out error grows by at most {max(worst, 0.0):.1f} % (mean square, worst joint)"
            )
            entry = {
                "effects": [{"effect": c.effect, "joints": [] if c.joint is None else [names[c.joint]]} for c in group],
                "why": why,
                "motion_that_would_tell": motion_that_would_tell(term, group, same),
            }
            if key not in found or loss < found[key][0]:
                found[key] = (loss, entry)
        listed = [entry for _, entry in sorted(found.values(), key=lambda item: (len(item[1]["effects"]), item[0]))]
        listed = [*forms[term], *_one_for_several(judge, terms, term), *listed]
        if (twin := term.family().twin(term, evidence.robot)) is not None:
            known = next(e for e in term.family().equivalent_to if e.effects == (twin.effect,))
            listed.insert(
                0,
                _as_declared(evidence, twin.effect, twin.joint, f"structurally the same: {known.why}", known),
            )
        out[term] = listed
    return out


def _other_forms(judge: Judge, terms: Sequence[Term], term: Term) -> list[dict[str, Any]]:
    """Other laws of the same family that leave no surely larger error."""
    out = []
    for form in forms_as_good(judge, terms, term):
        known = next(e for e in term.family().equivalent_to if e.effects == (form.effect,))
        settings = ", ".join(f"{k}: {v}" for k, v in form.settings) or "as it is without settings"
        why = f"the same effect with another law ({settings}) leaves as little: {known.why}"
        out.append(_as_declared(judge.evidence, form.effect, form.joint, why, known))
    return out


def _one_for_several(judge: Judge, terms: Sequence[Term], term: Term) -> list[dict[str, Any]]:
    """Families that say of themselves that ``term`` and others of its joint make their torque, where those do."""
    evidence, settings = judge.evidence, judge.settings
    out = []
    here = np.arange(evidence.n) == term.joint
    for name in (*settings.families, *settings.further):
        kind = family(name)
        for known in kind.equivalent_to:
            together = [t for t in terms if t.joint is not None and t.joint == term.joint and t.effect in known.effects]
            if term not in together or len(together) < 2 or {t.effect for t in together} != set(known.effects):
                continue
            offered = kind.terms(evidence.robot, here, settings.options)
            evidence.add_terms(offered)
            full, rest = evidence.held(terms, physical=True), [t for t in terms if t not in together]
            if any(judge.as_good(evidence.held([*rest, c], physical=True), full) for c in offered):
                why = f"in the place of {' and '.join(known.effects)}: {known.why}"
                out.append(_as_declared(evidence, name, term.joint, why, known))
    return out


def _as_declared(evidence: Evidence, name: str, joint: int | None, why: str, known: Equivalence) -> dict[str, Any]:
    """The entry of an alternative that a family declares itself, with the remedy that it gives."""
    return {
        "effects": [{"effect": name, "joints": [] if joint is None else [evidence.robot.joint_names[joint]]}],
        "why": why,
        "motion_that_would_tell": f"{known.remedy[0].upper()}{known.remedy[1:]}.",
    }


def motion_that_would_tell(term: Term, others: Sequence[Term], same: bool) -> str:
    """One sentence: which motion separates ``term`` from ``others``."""
    first, last = term.family().shown_by, others[-1]
    why = term.family().inseparable(term, last) or last.family().inseparable(last, term)
    if same and why:
        return why
    rest = list(dict.fromkeys(o.family().shown_by for o in others if o.family().shown_by != first))
    if not rest:
        return f"A motion in which {first}, one joint at a time."
    return f"A motion in which {first}; " + "; ".join(f"then one in which {clause}" for clause in rest) + "."


def undetermined(evidence: Evidence, terms: Sequence[Term], term: Term) -> list[str]:
    """Published parameters of ``term`` that the data leaves to the prior."""
    layout = evidence.layout(terms)
    a, _ = evidence.normal(layout, evidence.full_gram)
    scale = 1.0 / np.sqrt(np.diag(a))
    inverse = np.linalg.pinv(a * scale[:, None] * scale[None, :], rcond=1e-15, hermitian=True)
    variance = np.diag(inverse) * scale**2
    start = layout.starts[layout.terms.index(term)]
    kind = term.family()
    loose = variance[start : start + term.size] > 0.1 * kind.prior_scale(evidence.robot, term) ** 2
    return kind.left_open(term, loose)


def inconsistent(
    judge: Judge, terms: Sequence[Term], x: Array, inconsistent: Sequence[Term] = ()
) -> dict[Term, list[dict[str, Any]]]:
    """Effects whose parameters differ between training runs by more than uncertainty, fitted run by run.

    ``x`` are the coordinates of all terms. Every effect in turn is fitted to one run alone, the others held; it
    disagrees where its own parameters lower that run's error by more than one squared floor on enough joints (those of
    ``inconsistent`` have already been found better with parameters of their own in every run), and a
    parameter differs by more than three standard errors from the mean of the runs and by more than a few percent of
    the largest parameter of its unit.
    """
    evidence = judge.evidence
    runs = len(evidence.runs)
    out: dict[Term, list[dict[str, Any]]] = {}
    if runs < 2:
        return out
    layout = evidence.layout(terms)
    for term, start in zip(layout.terms, layout.starts, strict=True):
        kind = term.family()
        keys = kind.published({k: v for k, v in term.options.items() if k != ONLY_RUN})
        fits = []
        for r in range(runs):
            mine = evidence.blocks.run == r
            own, covariance, gain = fit_alone(evidence, terms, x, term, start, mine)
            fits.append((own, covariance, gain))
        if term not in inconsistent and not any(judge.matters(term, gain, 1.0) for _, _, gain in fits):
            continue
        values, errors = [], []
        for own, covariance, _ in fits:
            effect = effects_of(evidence, [term], own, covariance)[0]
            values.append([effect.parameters[key] for key in keys])
            errors.append([max(effect.std_errors[key], 1e-12) for key in keys])
        v, e = np.array(values), np.array(errors)
        mean = (v / e**2).sum(axis=0) / (1 / e**2).sum(axis=0)
        chi = (((v - mean) / e) ** 2).sum(axis=0)
        units = np.array([kind.unit(key, term.options) for key in keys])
        size = np.array([np.abs(v[:, units == unit]).max() for unit in units])
        spread = np.ptp(v, axis=0)
        entries = [
            {
                "parameter": key,
                "unit": str(units[k]),
                "runs": [
                    {"run": run.name, "value": float(v[r, k]), "std_error": float(e[r, k])}
                    for r, run in enumerate(evidence.runs)
                ],
            }
            for k, key in enumerate(keys)
            if chi[k] > 9.0 * (runs - 1) and spread[k] > DIFFERENCE * size[k]
        ]
        if entries:
            out[term] = entries
    return out


def fit_alone(
    evidence: Evidence, terms: Sequence[Term], x: Array, term: Term, start: int, blocks: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Coordinates of ``term`` on ``blocks`` with all others held at ``x``; covariance; gain (n,) [N m]^2."""
    layout = evidence.layout(terms)
    size = term.size
    own = slice(start, start + size)
    prior = 1.0 / term.family().prior_scale(evidence.robot, term) ** 2
    a, b = np.diag(prior), x[own] * prior
    grams = []
    for j, (position, column) in enumerate(evidence.indices(layout)):
        gram = evidence.gram[j]
        mine = np.flatnonzero((position >= start) & (position < start + size))
        others = np.setdiff1d(np.arange(len(position)), mine)
        taken = gram.pick(column[mine], column[others], blocks) @ x[position[others]]
        cross = gram.last[blocks][:, column[mine]] - taken
        square = gram.pick(column[mine], column[mine], blocks)
        at = position[mine] - start
        a[np.ix_(at, at)] += evidence.weights[j] * square.sum(axis=0)
        b[at] += evidence.weights[j] * cross.sum(axis=0)
        grams.append((at, square, cross))
    solution = np.asarray(np.linalg.solve(a, b))
    scores = np.zeros((int(blocks.sum()), size))
    for j, (at, square, cross) in enumerate(grams):
        scores[:, at] += evidence.weights[j] * (cross - square @ solution[at])
    bread = np.linalg.inv(a)
    count = len(scores)
    covariance = bread @ (scores.T @ scores) @ bread * count / max(count - 1, 1)
    changed = x.copy()
    changed[own] = solution
    rows = np.maximum(evidence.count[blocks].sum(axis=0), 1)
    gain = (evidence.errors(terms, x, blocks).sum(axis=0) - evidence.errors(terms, changed, blocks).sum(axis=0)) / rows
    return solution, np.asarray(covariance), np.asarray(gain)
