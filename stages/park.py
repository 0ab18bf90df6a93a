"""Stage park: the tables of all recorded arms in one place, and which arms are left out."""

import json

import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.layout import REPORTS, AddedFiles, DatasetFiles
from hybrid_dynamics.study.park import COLUMNS, PARAMETER_COLUMNS, REGIME_COLUMNS
from hybrid_dynamics.study.park.added import COLUMNS as ADDED_COLUMNS
from hybrid_dynamics.trajectory import RECORDED

TABLES = {
    "park": ("joints", COLUMNS),
    "park_regimes": ("regimes", REGIME_COLUMNS),
    "park_parameters": ("parameters", PARAMETER_COLUMNS),
}


def main() -> None:
    params = load_params()
    arms = section(params, "park", list[str])
    summaries = {arm: json.loads((DatasetFiles(arm).park / "summary.json").read_text(encoding="utf-8")) for arm in arms}
    present = [arm for arm in arms if summaries[arm]["provenance"] == RECORDED]
    for report, (table, columns) in TABLES.items():
        parts = [pd.read_csv(DatasetFiles(arm).park / f"{table}.csv") for arm in present]
        whole = pd.concat(parts) if parts else pd.DataFrame(columns=list(columns))
        write_text(REPORTS / f"{report}.csv", whole.to_csv(index=False))
    added = [AddedFiles(arm).scores for arm in section(params, "added_arms", list[str])]
    scores = [part for part in (pd.read_csv(path) for path in added) if len(part)]
    whole = pd.concat(scores) if scores else pd.DataFrame(columns=list(ADDED_COLUMNS))
    write_text(REPORTS / "added.csv", whole.to_csv(index=False))
    left_out = [arm for arm in arms if arm not in present]
    print(f"park: {len(present)} of {len(arms)} arms" + (f"; left out: {', '.join(left_out)}" if left_out else ""))


if __name__ == "__main__":
    run_main(main)
