"""What was measured, from the files that say it into ``docs/findings.md``: no number of that page is typed by hand.

    python -m benchmarks.findings                # from docs/*.csv and, where they are there, reports/*.csv

A section is written anew where its file is there and left as it is where it is not.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop_report.words import known, number, share, title_of
from hybrid_dynamics.study.intervals import counted
from hybrid_dynamics.study.report.resimulation import improving, without_before

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "findings.md"
HEAD = """# Findings

What was measured, apart from why things are built as they are ([architecture](architecture.md), [how the loop
decides](loop.md)). Every number below was written by `python -m benchmarks.findings` from the file that its section
names. What the study itself measures, with every table, is `reports/index.html` after `make repro`.
"""
#: Added torque, in noise floors, from which on a planted effect must be found (as on the study's page).
BLIND_SIZE = 3.0


@dataclass(frozen=True)
class Finding:
    """A section: its ``file`` below the root, who writes that, and ``tell``, which makes the lines from its table."""

    name: str
    title: str
    file: str
    writer: str
    tell: Callable[[pd.DataFrame], Iterable[str]]


def five_minutes(rows: pd.DataFrame) -> list[str]:
    """Time from logs to report and exports, and what was named, per arm."""
    body = [
        [
            row["arm"],
            str(row["joints"]),
            number(row["loop_cpu_s"], 3),
            number(row["exports_cpu_s"], 3),
            f"{row['cpu_s']:.0f}",
            f"{row['wall_s']:.0f} ({row['load_before']:g})",
            str(row["peak_memory_mb"]),
            f"{row['named_right']} of {row['hidden']}",
            title_of(row["named_besides"]) if isinstance(row["named_besides"], str) else "nothing",
            f"{share(row['held_out_error_before'], 3)} → {share(row['held_out_error_after'], 3)}",
        ]
        for row in rows.to_dict("records")
    ]
    met = int((rows["met"] == "yes").sum())
    return [
        "Five arms of example-robot-data that the study does not use, 4 runs of 16 s at 500 Hz each (3 to learn from, "
        "1 held out), Coulomb friction on every joint, viscous friction on every other, and a payload hidden; the loop "
        f"with its report, then {rows['exports'].iloc[0]} exports. Goal: at most {rows['goal_s'].iloc[0] / 60:.0f} "
        f"minutes on 2 cores; met on {met} of {len(rows)} by processor time. Wall time is that of a shared machine, "
        "with the number of processes that wanted a core in brackets; alone it is about the processor time, since one "
        "process runs after the other.",
        "",
        *_table(
            ["arm", "joints", "loop [CPU s]", "exports [CPU s]", "all [CPU s]", "wall [s] (load)", "peak [MB]",
             "named of hidden", "named besides", "held-out error"],
            body,
        ),
    ]  # fmt: skip


def glitches(rows: pd.DataFrame) -> list[str]:
    """Single wrong samples: how many cases leave the result as it is."""
    held = rows["holds"].astype(str) == "True"
    out = [
        "Single wrong samples put into logs of a small arm; the result holds (same names and verdict, parameters and "
        f"error as without them) in {counted(int(held.sum()), len(rows))}.",
        "",
    ]
    body = [
        [str(signal), f"{share:g}", counted(int(held[own.index].sum()), len(own))]
        for (signal, share), own in rows.groupby(["signal", "share"])
    ]
    return [*out, *_table(["signal", "share of the samples", "result holds"], body)]


def park(rows: pd.DataFrame) -> list[str]:
    """Recorded arms: errors per arm over its joints."""
    columns = ("rigid_body", "least_squares", "loop", "black_box", "floor")
    body = []
    for arm, own in rows.groupby("dataset", sort=False):
        size = [number(float((own[column] ** 2).sum() ** 0.5), 3) for column in columns]
        body.append([str(arm), *size, f"{100 * own['explained_share'].median():.0f} %"])
    return [
        "Held-out runs of recorded arms: root of the summed mean squares over the joints [N m]. Black box: boosted "
        "trees on top of the loop. Explained: median over the joints of the share of the error above the best of "
        "floor, least squares and black box that the loop removes.",
        "",
        *_table(
            ["arm", "rigid body", "least squares", "loop", "black box", "noise floor", "explained"],
            body,
        ),
    ]


def resimulation(rows: pd.DataFrame) -> list[str]:
    """State error of the exported model in MuJoCo, per arm."""
    body = []
    for (arm, provenance), own in rows.groupby(["dataset", "provenance"], sort=False):
        middle = {key: known(own[key].median()) for key in own.columns if key.endswith(("_before", "_after"))}
        body.append(
            [
                f"{arm} ({provenance})",
                f"{number(middle['position_before'], 3)} → {number(middle['position_after'], 3)}",
                f"{number(middle['velocity_before'], 3)} → {number(middle['velocity_after'], 3)}",
                improving(own),
                str(int(own["windows"].iloc[0])),
            ]
        )
    return [
        "The exported MJCF in MuJoCo under the recorded torque of held-out runs, windows of "
        f"{rows['window'].iloc[0]:g} s: state error of the median joint, URDF alone → completed model.",
        "",
        *_table(["arm", "position [rad]", "velocity [rad/s]", "joints that improve", "windows"], body),
        *(["", said] if (said := without_before(rows)) else []),
    ]


def blind(rows: pd.DataFrame) -> list[str]:
    """Effects planted in simulation: named right, and nothing wrong."""
    rows = rows.assign(
        hidden=rows["hidden"].fillna("").astype(str),
        right=(rows["named_right"].astype(str) == "True") & (rows["nothing_wrong_named"].astype(str) == "True"),
    )
    planted = rows["hidden"].map(lambda names: len(str(names).split()))
    large = rows[(planted == 0) | (rows["size_over_floor"] >= BLIND_SIZE)]
    body = [
        [str(robot), str(count) if count else "nothing", counted(int(own["right"].sum()), len(own))]
        for (robot, count), own in large.groupby(["robot", planted[large.index]])
    ]
    return [
        f"Effects planted in simulation, unknown to the loop, from {BLIND_SIZE:g} noise floors of added torque on.",
        "",
        *_table(["robot", "effects planted", "named right and nothing else"], body),
    ]


FINDINGS = (
    Finding("five-minutes", "Your own robot in five minutes", "docs/five_minutes.csv",
            "python -m benchmarks.five_minutes", five_minutes),
    Finding("glitches", "Single wrong samples", "docs/glitches.csv", "python -m tests.glitch_sweep", glitches),
    Finding("park", "Recorded arms", "reports/park.csv", "make repro", park),
    Finding("resimulation", "Simulated again in MuJoCo", "reports/resimulation.csv", "make repro", resimulation),
    Finding("blind", "Undeclared effects in simulation", "reports/blind.csv", "make repro", blind),
)  # fmt: skip


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows)]


def section(finding: Finding, root: Path = ROOT) -> str | None:
    """The section between its marks; None where its file is not there or holds no row."""
    path = root / finding.file
    if not path.is_file() or not len(table := pd.read_csv(path)):
        return None
    lines = [
        f"<!-- {finding.name} -->",
        f"## {finding.title}",
        "",
        f"From `{finding.file}`, written by `{finding.writer}`.",
        "",
        *finding.tell(table),
        f"<!-- end {finding.name} -->",
    ]
    return "\n".join(lines)


def page(before: str, root: Path = ROOT) -> str:
    """The whole page: sections whose file is there are new, the others as they stand in ``before``."""
    parts = [HEAD.rstrip()]
    for finding in FINDINGS:
        kept = re.search(rf"(?s)<!-- {finding.name} -->.*?<!-- end {finding.name} -->", before)
        new = section(finding, root) or (kept[0] if kept else None)
        if new is not None:
            parts.append(new)
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    write_text(PAGE, page(PAGE.read_text("utf-8") if PAGE.is_file() else ""))
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
