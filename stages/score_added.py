"""Stage score_added: compare what was named with what was added; the only stage that reads the truth."""

import json

import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.layout import AddedFiles
from hybrid_dynamics.study.park import score_added
from hybrid_dynamics.study.park.added import COLUMNS
from stages.common import dataset_argument


def main() -> None:
    added = AddedFiles(dataset_argument(__doc__).dataset)
    truths = json.loads(added.truth.read_text(encoding="utf-8"))
    said = [
        json.loads((added.diagnoses / truth["case"] / "diagnosis.json").read_text(encoding="utf-8")) for truth in truths
    ]
    rows = [score_added(truth, diagnosis, said[0]) for truth, diagnosis in zip(truths, said, strict=True)]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_text(added.scores, table.to_csv(index=False, float_format="%.6g"))
    asked = table[table["hidden"] != ""]
    print(f"{added.dataset}: {int(asked['named_right'].sum())} of {len(asked)} added effects named right")


if __name__ == "__main__":
    run_main(main)
