"""Stage report: every table, figure and the page, from the result files of all datasets."""

import json
from pathlib import Path

import pandas as pd

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.files import write_text
from hybrid_dynamics.study.blind_score import COLUMNS, LOOP_SECONDS
from hybrid_dynamics.study.blind_table import read_cases
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import RobotSettings, picture_of
from hybrid_dynamics.study.layout import REPORTS, RESIMULATION_COLUMNS, BlindFiles, DatasetFiles
from hybrid_dynamics.study.park.collect import collect_park
from hybrid_dynamics.study.report import write_report
from hybrid_dynamics.study.report.campaign import campaign_sections
from hybrid_dynamics.study.report.sections import derivative_section, study_sections
from hybrid_dynamics.study.results import StudyInputs


def scored(files: BlindFiles) -> pd.DataFrame:
    """Scores of one robot's blind cases, and the time that the loop took for each."""
    table = read_cases(files.scores)
    seconds = json.loads(files.timing.read_text("utf-8"))
    return table.assign(**{LOOP_SECONDS: [seconds.get(case) for case in table["case"]]})


def main() -> None:
    params = load_params()
    names = section(params, "datasets", list[str])
    robots = {name: section(params, f"dataset.{name}.robot", RobotSettings) for name in names}
    steps = pd.concat([pd.read_csv(DatasetFiles(name).model("loop") / "steps.csv") for name in names])
    write_text(REPORTS / "loop.csv", steps.to_csv(index=False))
    arms = section(params, "park", list[str])
    # An arm that is a data set too is simulated once: its model is the same.
    places = [DatasetFiles(name).resimulation for name in names]
    places += [DatasetFiles(arm).park_resimulation for arm in arms if arm not in names]
    again = [table for place in places if len(table := pd.read_csv(place))]
    table = pd.concat(again) if again else pd.DataFrame(columns=list(RESIMULATION_COLUMNS))
    write_text(REPORTS / "resimulation.csv", table.to_csv(index=False))
    scores = [scored(BlindFiles(name)) for name in section(params, "blind_robots", list[str])]
    blind = pd.concat(scores) if scores else pd.DataFrame(columns=[*COLUMNS, LOOP_SECONDS])
    write_text(REPORTS / "blind.csv", blind.to_csv(index=False))
    left_out = collect_park(arms, section(params, "added_arms", list[str]), REPORTS)
    if arms:
        without = f"; left out: {', '.join(left_out)}" if left_out else ""
        print(f"park: {len(arms) - len(left_out)} of {len(arms)} arms{without}")
    compared = section(params, "compared", list[str])
    extra = [derivative_section(DatasetFiles(name).derivative_errors) for name in compared]
    study = StudyInputs(
        data=Path("data"),
        datasets=tuple(names),
        titles={name: section(params, f"dataset.{name}.title", str) for name in names},
        pictures={name: path for name, robot in robots.items() if (path := picture_of(robot)) is not None},
        blind=REPORTS / "blind.csv" if scores else None,
        park=REPORTS / "park.csv" if arms else None,
        sections=(*study_sections(names), *campaign_sections(REPORTS), *filter(None, extra)),
    )
    print(f"report: {write_report(study, REPORTS)}")


if __name__ == "__main__":
    run_main(main)
