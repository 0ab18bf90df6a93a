"""What the data leaves open in what is named: parameters that only the prior holds, runs that disagree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_dynamics.effects import Term
from hybrid_dynamics.effects.base import ONLY_RUN
from hybrid_dynamics.effects.units import unit_of
from hybrid_dynamics.loop.augment import effects_of
from hybrid_dynamics.loop.evidence import Evidence
from hybrid_dynamics.loop.tangents import ONE_DIRECTION, directions
from hybrid_dynamics.loop.trace import Judge
from hybrid_dynamics.types import Array

#: Parameters of two runs that differ by less than this share are the same: drive gains are no better known.
DIFFERENCE = 0.05
#: Share of what the samples say that stands for a direction of which they say nothing.
NOTHING_KNOWN = 1e-12
#: A coordinate with more than this share in a direction that no sample knows is not known.
SHARED = 0.01


def undetermined(evidence: Evidence, terms: Sequence[Term], term: Term) -> list[str]:
    """Published parameters of ``term`` that the data leaves to the prior, or to another of ``terms``: on a joint that
    turns one way only Coulomb friction and an offset are one constant."""
    # How near links are held for the prediction says nothing of them.
    evidence, layout = evidence.holding_links(1.0), evidence.layout(terms)
    # What is held to be like another number is not known by that, nor what friction may hold at rest.
    held = evidence.problem.alike(layout) + evidence.rest_normal(layout)
    scale, values, vectors = directions(evidence.normal(layout)[0] - held)
    known = values > ONE_DIRECTION
    variance = (vectors[:, known] ** 2 @ (1.0 / values[known])) * scale**2
    start = layout.starts[layout.terms.index(term)]
    own = slice(start, start + term.size)
    kind = term.family()
    loose = variance[own] > 0.1 * kind.open_scale(evidence.robot, term) ** 2
    loose |= np.sum(vectors[own][:, ~known] ** 2, axis=1) > SHARED
    return kind.left_open(term, loose)


def inconsistent(
    judge: Judge, terms: Sequence[Term], x: Array, inconsistent: Sequence[Term] = (), beside: Sequence[Term] = ()
) -> dict[Term, list[dict[str, Any]]]:
    """Effects whose parameters differ between training runs by more than uncertainty, fitted run by run.

    ``x`` are the coordinates of all terms and of what stands ``beside`` them. Every effect in turn is fitted to one run
    alone, the others held; it disagrees where its own parameters lower that run's error by more than one squared floor
    on enough joints (those of ``inconsistent`` have already been found better with parameters of their own in every
    run), and a parameter differs by more than three standard errors from the mean of the runs and by more than a few
    percent of the largest parameter of its unit.
    """
    evidence = judge.evidence
    runs = len(evidence.runs)
    out: dict[Term, list[dict[str, Any]]] = {}
    if runs < 2:
        return out
    layout = evidence.layout([*terms, *beside])
    for term, start in zip(layout.terms[: len(terms)], layout.starts, strict=False):
        kind = term.family()
        keys = kind.published({k: v for k, v in term.options.items() if k != ONLY_RUN})
        fits = []
        for r in range(runs):
            mine = evidence.blocks.run == r
            own, covariance, gain = fit_alone(evidence, layout.terms, x, np.arange(start, start + term.size), mine)
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
        units = np.array([unit_of(effect, key, evidence.robot.prismatic) for key in keys])
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
    evidence: Evidence, terms: Sequence[Term], x: Array, own: NDArray[np.int_], blocks: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """The coordinates ``own`` (rising numbers) on ``blocks`` with all others of ``terms`` held at ``x``; covariance;
    gain (n,) [N m]^2. Along a direction that these blocks leave open ``x`` stays, and nothing is known."""
    layout = evidence.layout(terms)
    prior = 1.0 / np.concatenate([t.prior_scale(evidence.robot) for t in layout.terms])[own] ** 2
    a, b = np.diag(prior), x[own] * prior
    grams = []
    for j, (position, column) in enumerate(evidence.indices(layout)):
        gram = evidence.gram[j]
        mine = np.flatnonzero(np.isin(position, own))
        others = np.setdiff1d(np.arange(len(position)), mine)
        taken = gram.pick(column[mine], column[others], blocks) @ x[position[others]]
        cross = gram.last[blocks][:, column[mine]] - taken
        square = gram.pick(column[mine], column[mine], blocks)
        at = np.searchsorted(own, position[mine])
        a[np.ix_(at, at)] += evidence.weights[j] * square.sum(axis=0)
        b[at] += evidence.weights[j] * cross.sum(axis=0)
        grams.append((at, square, cross))
    unit, values, vectors = directions(a)
    told = values > ONE_DIRECTION
    known, free = vectors[:, told] * unit[:, None], vectors[:, ~told] * unit[:, None]
    bread = known / values[told] @ known.T
    solution = np.asarray(x[own] + bread @ (b - a @ x[own]))
    scores = np.zeros((int(blocks.sum()), len(own)))
    for j, (at, square, cross) in enumerate(grams):
        scores[:, at] += evidence.weights[j] * (cross - square @ solution[at])
    count = len(scores)
    covariance = bread @ (scores.T @ scores) @ bread * count / max(count - 1, 1) + free @ free.T / NOTHING_KNOWN
    changed = x.copy()
    changed[own] = solution
    rows = np.maximum(evidence.count[blocks].sum(axis=0), 1)
    gain = (evidence.errors(terms, x, blocks).sum(axis=0) - evidence.errors(terms, changed, blocks).sum(axis=0)) / rows
    return solution, np.asarray(covariance), np.asarray(gain)
