"""How sure a share is that was counted on few cases."""

from __future__ import annotations

from scipy.stats import beta

#: Of intervals made this way at least this share hold the true value.
CONFIDENCE = 0.95


def clopper_pearson(hits: int, cases: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact interval of a binomial share (Clopper and Pearson 1934); (0, 1) where nothing was counted.

    Raises ``ValueError`` where ``hits`` is not between 0 and ``cases``.
    """
    if not 0 <= hits <= cases:
        raise ValueError(f"{hits} of {cases} is no count; expected 0 <= hits <= cases")
    tail = (1 - confidence) / 2
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, cases - hits + 1))
    high = 1.0 if hits == cases else float(beta.ppf(1 - tail, hits + 1, cases - hits))
    return low, high


def counted(hits: int, cases: int) -> str:
    """``9 of 10 (95 % interval 55 to 100 %)``."""
    low, high = clopper_pearson(hits, cases)
    return f"{hits} of {cases} ({100 * CONFIDENCE:g} % interval {100 * low:.0f} to {100 * high:.0f} %)"
