"""What the loop set out to show on effects hidden in simulation, from the rows of ``blind.csv``."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from hybrid_dynamics.study.blind_table import (
    ALL_CLEAR,
    LONG,
    NOTHING,
    SIZE,
    clean,
    effects_of,
    found,
    missing,
    silent,
    strange,
)
from hybrid_dynamics.study.intervals import clopper_pearson, counted
from hybrid_dynamics.study.results import Check

#: Shares that are claimed: effects found, of every family, cases said to be explained, without a wrong name, with a
#: held-out error within :data:`AFTER_BOUND`; of nothing hidden, without a name.
FOUND, OF_FAMILY, EXPLAINED, CLEAN, CLOSE, NO_ALARM = 0.95, 0.9, 0.85, 0.95, 0.9, 0.99
#: Half of the effects of this size [floors] must be found: those drawn between it and a half of it less are counted.
HALF_FOUND = (1.5, 2.0)
#: Explanations listed beside the names, a case on average.
ALTERNATIVES = 1.5
#: A share is shown where its interval ends no more than this below it.
SLACK = 0.1
MEDIAN_ERROR, TAIL_ERROR, LOOSE_ERROR = 0.01, 0.05, 0.2
#: Families of which some parameters are known only where the joint turns around.
LOOSE = ("stribeck_friction", "hysteresis_friction")
COVERAGE = (0.88, 0.99)
AFTER_BOUND, FLOOR_BOUND = 1.15, 0.2


def blind_checks(cases: pd.DataFrame) -> Iterator[Check]:
    """Claims on hidden effects; effects count from :data:`SIZE` floors on in logs of :data:`LONG` s or more."""
    if not len(cases):
        return
    title = f"hidden effects ({', '.join(sorted(set(cases['robot'])))})"
    beyond, lacking, right = strange(cases), missing(cases), clean(cases)
    said = cases["verdict"].isin(ALL_CLEAR)

    def share(claim: str, hits: pd.Series, least: float) -> Iterator[Check]:
        if len(hits):
            yield Check(title, claim, *_counted(int(hits.sum()), len(hits), least), len(hits))

    yield from share(
        "A law that the catalogue does not have is hidden: no name of another effect beside an all-clear",
        ~(said & ~right)[beyond],
        1.0,
    )
    yield from share(f"Nothing wrong named in at least {100 * CLEAN:g} %", right[~beyond & lacking], CLEAN)
    yield from share("Nothing hidden: at most 1 false alarm in 100", right[~lacking], NO_ALARM)
    mute = silent(cases)
    inside = said[~beyond & lacking & ~mute]
    what = "Inside the catalogue, the torque of every joint changing: explained"
    yield from share(f"{what} in at least {100 * EXPLAINED:g} %", inside, EXPLAINED)
    # A sensor that is too coarse, or not connected, leaves something that no data can clear.
    yield from share("The torque of a joint never changes: no all-clear", ~said[mute], 1.0)
    effects = effects_of(cases)
    yield from _effects(title, effects)
    yield from _parameters(title, effects[~effects["strange"].astype(bool)])
    alternatives = float(cases["alternatives"].mean())
    claim = f"At most {ALTERNATIVES:g} alternatives listed a case on average"
    yield Check(title, claim, f"{alternatives:.2f}", alternatives <= ALTERNATIVES, len(cases))
    yield from _models(title, cases[~beyond])


def _effects(title: str, effects: pd.DataFrame) -> Iterator[Check]:
    large = effects[(effects["size"] >= SIZE) & (effects["seconds"] >= LONG)]
    if len(large):
        what = f"Effects of {SIZE:g} floors or more in {LONG:g} s or more: named, or listed with the reason"
        hits = found(large)
        claim = f"{what}, in at least {100 * FOUND:g} %"
        yield Check(title, claim, *_counted(int(hits.sum()), len(hits), FOUND), len(hits))
        of_family = hits.groupby(large["effect"]).mean()
        own = hits[large["effect"] == of_family.idxmin()]
        text = f"fewest: {str(of_family.idxmin()).replace('_', ' ')}, {counted(int(own.sum()), len(own))}"
        claim = f"{what}, of every family in at least {100 * OF_FAMILY:g} %"
        yield Check(title, claim, text, bool(of_family.min() >= OF_FAMILY), len(hits))
    low, high = HALF_FOUND
    small = effects[(effects["size"] >= low) & (effects["size"] < high) & (effects["seconds"] >= LONG)]
    if len(small):
        claim = f"Half of the effects of {low:g} to {high:g} floors are found"
        yield Check(title, claim, *_counted(int(found(small).sum()), len(small), 0.5), len(small))


def _parameters(title: str, effects: pd.DataFrame) -> Iterator[Check]:
    named = effects[effects["parameter_error"].notna() & (effects["size"] >= NOTHING)]
    large = named[(named["size"] >= SIZE) & (named["seconds"] >= LONG)]
    loose = large["effect"].isin(LOOSE)
    errors = large.loc[~loose, "parameter_error"].astype(float)
    if len(errors):
        median, tail = float(errors.median()), float(errors.quantile(0.9))
        yield Check(
            title,
            f"Parameter error at most {100 * MEDIAN_ERROR:g} % (median) and {100 * TAIL_ERROR:g} % (90th percentile)",
            f"{100 * median:.2g} %, {100 * tail:.2g} %",
            median <= MEDIAN_ERROR and tail <= TAIL_ERROR,
            len(errors),
        )
    errors = large.loc[loose, "parameter_error"].astype(float)
    if len(errors):
        tail = float(errors.quantile(0.9))
        claim = f"Stribeck and Dahl friction: parameter error at most {100 * LOOSE_ERROR:g} % (90th percentile)"
        yield Check(title, claim, f"{100 * tail:.2g} %", tail <= LOOSE_ERROR, len(errors))
    checked, within = int(named["checked"].sum()), int(named["within"].sum())
    if checked:
        low, high = COVERAGE
        claim = f"{100 * low:g} to {100 * high:g} % of the parameters lie within two standard errors"
        yield Check(title, claim, counted(within, checked), low <= within / checked <= high, checked)


def _models(title: str, cases: pd.DataFrame) -> Iterator[Check]:
    if not len(cases):
        return
    for rows, where in (("", "samples in motion"), ("_all_rows", "all samples")):
        close = cases[f"rmse_after{rows}"] <= AFTER_BOUND * cases[f"rmse_true_model{rows}"]
        claim = f"Held-out error at most {AFTER_BOUND:g} times the true model's in at least {100 * CLOSE:g} %, {where}"
        yield Check(title, claim, *_counted(int(close.sum()), len(close), CLOSE), len(close))
    low, high = float(cases["floor_over_true_model"].min()), float(cases["floor_over_true_model"].max())
    yield Check(
        title,
        f"Estimated noise floor within {100 * FLOOR_BOUND:g} % of the true model's error",
        f"{low:.3f} to {high:.3f} of it",
        low >= 1 - FLOOR_BOUND and high <= 1 + FLOOR_BOUND,
        len(cases),
    )


def _counted(hits: int, cases: int, share: float) -> tuple[str, bool | None]:
    """The count with its interval, and whether it meets ``share``; None where so few cases show nothing.

    Few cases show nothing where all that was counted is right and the interval still reaches :data:`SLACK` below.
    """
    text = counted(hits, cases)
    if hits < share * cases:
        return text, False
    if clopper_pearson(hits, cases)[0] < share - SLACK:
        return f"{text}: too few cases to decide", None
    return text, True
