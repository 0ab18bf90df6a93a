"""What the closed loop set out to show on the park of recorded arms: no worse than the classical baseline."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from hybrid_dynamics.study.park.tables import AGAINST
from hybrid_dynamics.study.results import Check
from hybrid_dynamics.trajectory import RECORDED


def park_checks(rows: pd.DataFrame) -> Iterator[Check]:
    """A claim an arm, from the rows of ``park.csv``; none where they do not hold the comparison."""
    if AGAINST not in rows:
        return
    for name, own in rows.groupby("dataset", sort=False):
        first = own.iloc[0]
        worse = [str(joint) for joint in own["joint"][own[f"{AGAINST}_verdict"] == "worse"]]
        better = int((own[f"{AGAINST}_verdict"] == "better").sum())
        value, error = (100 * float(first[f"arm_{AGAINST}{end}"]) for end in ("", "_error"))
        yield Check(
            f"{name} ({RECORDED})",
            "Closed loop on the held-out runs: mean square error at most that of least squares within its uncertainty, "
            "on every joint and together",
            f"together {value:+.0f} ± {error:.2g} %; beyond its uncertainty better on {better} of {len(own)} "
            "joints, worse on " + (f"joint{'s' * (len(worse) > 1)} {', '.join(worse)}" if worse else "none"),
            not worse and first[f"arm_{AGAINST}_verdict"] != "worse",
        )
