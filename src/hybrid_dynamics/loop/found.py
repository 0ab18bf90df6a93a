"""What a search has found, as a value, and the models it makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from hybrid_dynamics.effects import Effect, Term
from hybrid_dynamics.loop.augment import effects_of, model_of
from hybrid_dynamics.loop.model import Model
from hybrid_dynamics.loop.search import Step
from hybrid_dynamics.loop.tangents import published_covariance
from hybrid_dynamics.loop.trace import Judge, has_all_links
from hybrid_dynamics.types import Array


@dataclass(frozen=True)
class Found:
    """``terms`` and their coordinates ``x``; ``inconsistent``: those whose parameters differ between runs; ``steps``;
    ``judge`` as it weighed the joints in the end; ``beside``: estimated beside these, and no finding (:mod:`.beside`);
    ``start``: the model that is completed (the search may have begun from one whose base is turned, :mod:`.mounting`);
    ``contacts``: effects of a moment (:mod:`.contact`), which stand last in every model; ``instead``: another end of
    the search, with gains of single joints (:mod:`.all_gains`), that all links may stand for."""

    terms: list[Term]
    x: Array
    inconsistent: list[Term]
    steps: list[Step]
    notes: list[str]
    judge: Judge
    start: Model
    beside: list[Term] = field(default_factory=list)
    contacts: list[Effect] = field(default_factory=list)
    instead: list[Term] = field(default_factory=list)

    def effects(self, covariance: bool = True) -> list[Effect]:
        """With published parameters and standard errors."""
        evidence = self.judge.evidence
        own = published_covariance(evidence, self.terms, self.x) if covariance else None
        return effects_of(evidence, self.terms, self.x, own)

    def named(self, full: Model) -> list[Effect]:
        """Of ``full``, the model of all :attr:`terms`, their effects in their order."""
        added = full.effects[len(self.start.effects) : len(full.effects) - len(self.contacts)]
        return [e for e in added if e.is_finding]

    def model(self, terms: Sequence[Term], covariance: bool = True) -> Model:
        """The completed model with ``terms`` of these alone: re-fitted, but where runs disagree.

        Its effects are those of ``terms`` in their order, then what stands ``beside`` them.
        """
        return self.start.adding([*self._laws(terms, covariance), *self.contacts])

    def steps_to(self, full: Model) -> list[Model]:
        """The models after each finding, from the start to ``full``."""
        laws = [self.start.adding(self._laws(self.terms[: k + 1], False)) for k in range(len(self.terms))]
        last = len(full.effects) - len(self.contacts)
        moments = [Model(full.robot, full.effects[: last + k + 1]) for k in range(len(self.contacts))]
        models = [self.start, *laws, *moments]
        models[-1] = full
        return models

    def _laws(self, terms: Sequence[Term], covariance: bool) -> Sequence[Effect]:
        """Effects of ``terms``, re-fitted, and what stands beside them."""
        if not terms:
            return []
        if self.inconsistent:
            return [e for s, e in zip(self.terms, self.effects(covariance), strict=True) if s in terms]
        lacks_links = has_all_links(self.terms) and not has_all_links(terms)
        beside = [t for t in self.beside if not (lacks_links and t.family().like_weight)]
        evidence = self.judge.evidence
        return model_of(evidence, [*terms, *beside], covariance).effects[len(evidence.base.effects) :]
