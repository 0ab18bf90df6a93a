"""The study as one page an engineer reads from the top down: verdict, tables, figures, equations, sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from hybrid_dynamics.files import write_text
from hybrid_dynamics.loop_report import html
from hybrid_dynamics.loop_report.book import FigureBook
from hybrid_dynamics.loop_report.details import STUDY_PART
from hybrid_dynamics.loop_report.html import Heading, escape
from hybrid_dynamics.loop_report.page import render_page, render_section
from hybrid_dynamics.loop_report.sections import Answer
from hybrid_dynamics.study.blind_table import read_cases
from hybrid_dynamics.study.claims import paper
from hybrid_dynamics.study.claims.checks import checks
from hybrid_dynamics.study.claims.coefficients import damping_of
from hybrid_dynamics.study.methods import REFERENCES, in_order, label, what
from hybrid_dynamics.study.report import figures, pieces
from hybrid_dynamics.study.report.arm import render_arm
from hybrid_dynamics.study.report.tables import timing_table, write_tables
from hybrid_dynamics.study.results import Check, DatasetResults, Section, StudyInputs, read_csv, read_study
from hybrid_dynamics.trajectory import RECORDED, SIMULATED_TWIN, Trajectory, iter_trajectories

TITLE = "Interpretable hybrid robot dynamics: the study"

#: Bytes of images in the page: what the plotting library and the tables leave of three megabytes.
IMAGES_LIMIT = 690_000


def write_report(study: StudyInputs, out_dir: Path) -> Path:
    """Write tables, figures and ``index.html`` of ``study`` to ``out_dir``; returns the path of the page.

    Every file is written under a temporary name and renamed; the page comes last.
    """
    out_dir = Path(out_dir)
    results = read_study(study)
    blind = read_cases(study.blind) if study.blind is not None else None
    park = read_csv(study.park) if study.park is not None else None
    checked = checks(results, blind, park)
    write_tables(results, checked, out_dir)
    writer = _Page()
    _opening(writer, results, checked, study)
    for result in results:
        _dataset(writer, result, study, out_dir / "figures")
    _closing(writer, results, checked, study)
    path = out_dir / "index.html"
    write_text(path, render_page(TITLE, writer.parts, writer.book, writer.headings, kind="study"))
    return path


class _Page:
    """Collects the page's parts, its headings and its interactive figures."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.headings: list[Heading] = []
        self.book = FigureBook()
        self._images = 0

    def add(self, *parts: str) -> None:
        self.parts += [part for part in parts if part]

    def image(self, content: bytes, path: Path, caption: str, css: str = "") -> str:
        """An image, embedded as long as the page stays light; then the place of its file, beside the page."""
        self._images += len(content)
        if self._images > IMAGES_LIMIT:
            return f"<p class='note'>{escape(caption)} Drawn in <code>figures/{escape(path.name)}</code>.</p>"
        return html.figure(content, escape(caption), caption, "webp", css)

    def heading(self, level: int, title: str, anchor: str, after: str = "", in_contents: str = "") -> None:
        self.headings.append(Heading(level, title + in_contents, html.slug(anchor)))
        self.add(f'<h{level} id="{html.slug(anchor)}">{escape(title)}{after}</h{level}>')


def _opening(page: _Page, results: Sequence[DatasetResults], checked: Sequence[Check], study: StudyInputs) -> None:
    required = [check for check in checked if check.met is not None]
    met = sum(bool(check.met) for check in required)
    page.add(f"<h1>{escape(TITLE)}</h1>")
    page.add(
        "<p class='lead'>Measured joint torque is the rigid-body torque plus a residual. This study learns the "
        "residual with symbolic regression, SINDy, networks and their hybrids, and sets every number beside that of "
        "the paper it repeats (Mower, Zong, Bou-Ammar: <i>Data-driven Interpretable Hybrid Robot Dynamics</i>).</p>"
    )
    twins = [result.name for result in results if result.provenance == SIMULATED_TWIN]
    if twins:
        page.add(
            f"<p class='warning'><b>{escape(', '.join(twins))}: simulated twin.</b> The recording could not be had, so "
            "a simulation of the same robot with published friction stands in. Nothing below about "
            f"{'it' if len(twins) == 1 else 'them'} is a statement about the real arm.</p>"
        )
    if required:
        undecided = sum(check.met is None and check.n is not None for check in checked)
        more = f"; {undecided} rest on too few cases to decide" if undecided else ""
        page.add(
            f"<p class='lead'><b>{met} of {len(required)}</b> required claims are met by the numbers below{more}: "
            "<a href='#claims'>all claims</a>, after the data they rest on.</p>"
        )
        page.add(_not_met([check for check in required if not check.met]))
    page.heading(2, "What was run", "what-was-run")
    page.add(_inventory(results))
    beside = [f'<a href="#{html.slug(f"-{s.name}")}">{escape(s.title)}</a>' for s in study.sections if not s.dataset]
    if beside:
        page.add(f"<p>Beside these data sets: {'; '.join(beside)}.</p>")
    page.add(
        "<p class='note'>Errors: <b>relative RMSE</b> of joint j is rms(τ<sub>j</sub> − τ̂<sub>j</sub>) / "
        "std(τ<sub>j</sub>) (1 is as bad as predicting the mean); <b>pooled</b> is ‖τ − τ̂‖ / ‖τ‖ over all joints. "
        "Bold on green: the best of the column; red: above 1. Small grey numbers are the paper's.</p>"
    )
    methods = in_order(method for result in results for method in result.methods)
    rows = [[html.Cell(escape(label(m)), "text"), html.Cell(escape(what(m)), "text")] for m in methods]
    page.add(html.details("The methods", html.table(["Method", "What it is"], rows)))


def _not_met(missed: Sequence[Check]) -> str:
    """The claims that do not hold, where nobody overlooks them."""
    if not missed:
        return ""
    lines = "".join(
        f"<li><b>{escape(check.dataset)}</b>: {escape(check.claim)}. Measured: {escape(check.measured)}.</li>"
        for check in missed
    )
    return f"<p><span class='missed'>✗ not met</span>:</p><ul>{lines}</ul>"


def _inventory(results: Sequence[DatasetResults]) -> str:
    rows: list[list[html.Cell | str]] = []
    for result in results:
        runs = " + ".join(f"{len(result.trajectories(split))} {split}" for split in ("train", "test"))
        rows.append(
            [
                html.Cell(f'<a href="#{html.slug(result.name)}">{escape(result.display_name)}</a>', "text"),
                html.Cell(html.badge(result.provenance), "text"),
                html.Cell(escape(f"{result.robot}, {result.n_joints} joints"), "text"),
                html.Cell(escape(runs), "text"),
                str(len(result.methods)),
            ]
        )
    return html.table(["Dataset", "Provenance", "Robot", "Runs", "Methods"], rows)


def _dataset(page: _Page, result: DatasetResults, study: StudyInputs, folder: Path) -> None:
    page.heading(2, result.display_name, result.name, f" {html.badge(result.provenance)}", f" ({result.provenance})")
    if result.provenance == SIMULATED_TWIN:
        page.add("<p class='warning'>Everything in this chapter was computed from a <b>simulated twin</b>.</p>")
    best = _best(result)
    page.add(_sentence(result, best))
    if result.name in study.pictures:
        page.add(_picture(page, result, study.pictures[result.name], folder))
    page.add(pieces.best_beside_rigid_body(result))
    if result.extrapolation is not None:
        page.add(
            "<p class='note'>How far the held-out runs extrapolate: their features lie "
            f"{result.extrapolation.distance:.3g} times as far from the training mean as those of the training runs do "
            f"(Mahalanobis, rms); in {100 * result.extrapolation.outside:.3g} % of the samples at least one of them "
            "lies outside its training range.</p>"
        )
    page.heading(3, "Torque errors", f"{result.name}-errors")
    for split in ("train", "test"):
        if result.trajectories(split):
            page.add(_errors(result, split))
    page.add(*_error_figures(page, result, folder, best))
    if damping_of(result) is not None and len(result.expressions):
        page.heading(3, "Table III: the identified models", f"{result.name}-models")
        page.add(
            "<p>Terms and coefficients of every closed-form model beside the truth and the paper's. A torque that is "
            "identically zero"
            + (f" ({escape(', '.join(result.zero_torques))})" if result.zero_torques else "")
            + " has no coefficient.</p>"
        )
        page.add(pieces.table_three_html(result))
    for section in study.sections:
        if section.dataset == result.name:
            _section(page, section, result)
    if len(result.expressions):
        page.heading(3, "Equations", f"{result.name}-equations")
        page.add(pieces.equations(result, beside=result.name == "wam"))
    if len(result.fronts):
        page.heading(3, "Pareto fronts", f"{result.name}-fronts")
        methods = in_order(result.fronts["method"])
        drawn = figures.fronts(result.fronts, methods, f"{result.title}: complexity against error")
        caption = (
            "What each further node buys: candidates of the first round (line) and the expression after all rounds, "
            "its constants fitted again (star)."
        )
        page.add(_figure(page, drawn, folder / f"{result.name}_fronts.svg", caption))
    page.heading(3, "Motion", f"{result.name}-motion")
    page.add(*_motion_figures(page, result, folder))


def _best(result: DatasetResults) -> str:
    """The learned method with the smallest pooled error on the held-out runs (training runs where none is held out)."""
    split = "test" if result.trajectories("test") else "train"
    pooled = result.pooled(split, "relative_error").iloc[0]
    learned = pooled.drop(list(REFERENCES), errors="ignore")
    return str((learned if len(learned) else pooled).idxmin())


def _sentence(result: DatasetResults, best: str) -> str:
    split = "test" if result.trajectories("test") else "train"
    pooled = result.pooled(split, "relative_error").iloc[0]
    start = f"{100 * pooled['rigid_body']:.3g} %" if "rigid_body" in pooled else "unknown"
    kind = "held-out" if split == "test" else "training"
    return (
        f"<p class='lead'>On the {kind} runs the rigid body alone is off by {start} of the torque; the best model, "
        f"<b>{escape(label(best))}</b>, by <b>{100 * pooled[best]:.3g} %</b>.</p>"
    )


def _errors(result: DatasetResults, split: str) -> str:
    reference = paper.error_table(result.name, split)
    kind = "held-out runs" if split == "test" else "training runs"
    number = f"Table {reference.number}. " if reference else ""
    caption = (
        f"<b>{number}{escape(result.display_name)}, {escape(result.provenance)}</b>: relative RMSE per joint, {kind}"
    )
    if reference and result.name == "wam" and result.provenance != RECORDED:
        caption += " (the paper's values are of the recording)"
    return "\n".join(
        [
            pieces.error_table(result, split, caption, reference),
            pieces.run_tables(result, split),
            pieces.joint_errors(result, split),
        ]
    )


def _figure(page: _Page, drawn: Figure, path: Path, caption: str) -> str:
    return page.image(figures.save(drawn, path), path, caption)


def _picture(page: _Page, result: DatasetResults, urdf: Path, folder: Path) -> str:
    trajectory = _first(result.folder / "trajectories.parquet", "test")
    if trajectory is None:
        return ""
    row = len(trajectory.time) // 2
    pose: Mapping[str, float] = dict(zip(result.joint_names, trajectory["q"][row], strict=True))
    content = render_arm(urdf, pose, folder / f"{result.name}_arm.png")
    caption = (
        f"The simulated arm in its pose at t = {trajectory.time[row]:.2f} s of run {trajectory.name}, drawn from the "
        "meshes of its URDF (the paper's Fig. 1)."
    )
    return page.image(figures.webp(content), folder / f"{result.name}_arm.png", caption, css="arm")


def _first(path: Path, split: str) -> Trajectory | None:
    for wanted in (split, None):
        found = list(islice(iter_trajectories(path, wanted), 1)) if path.exists() else []
        if found:
            return found[0]
    return None


def _motion_figures(page: _Page, result: DatasetResults, folder: Path) -> Iterator[str]:
    rollout = _first(result.folder / "trajectories.parquet", "train")
    if rollout is not None:
        drawn = figures.rollout(_thin(rollout), f"{result.title}: run {rollout.name}")
        caption = f"States and torques of run {rollout.name} (the paper's Fig. 2)."
        yield _figure(page, drawn, folder / f"{result.name}_rollout.png", caption)
    derived = _first(result.folder / "derivatives.parquet", "train")
    if derived is not None:
        drawn = figures.derivatives(_thin(derived), f"{result.title}: run {derived.name}")
        caption = f"Positions and estimated velocity, acceleration and jerk of run {derived.name} (the paper's Fig. 3)."
        yield _figure(page, drawn, folder / f"{result.name}_derivatives.png", caption)


def _thin(trajectory: Trajectory, points: int = 6000) -> Trajectory:
    step = max(1, -(-len(trajectory.time) // points))
    return trajectory.rows(slice(None, None, step))


def _error_figures(page: _Page, result: DatasetResults, folder: Path, best: str) -> Iterator[str]:
    if result.trajectories("test"):
        drawn = figures.error_bars(result.pooled("test"), f"{result.title}: held-out runs")
        yield _figure(
            page, drawn, folder / f"{result.name}_errors.svg", "Relative RMSE of every method on the held-out runs."
        )
    table = result.predictions
    if table.empty:
        return
    shown = list(dict.fromkeys(m for m in ("sr", best) if m in set(table["method"])))
    for split in ("train", "test"):
        if (table["split"] == split).any() and shown:
            drawn = figures.predictions(table, split, shown, f"{result.title}, measured and predicted torque")
            caption = f"Measured and predicted torque per joint, {split} (the paper's Fig. 4)."
            yield _figure(page, drawn, folder / f"{result.name}_torque_{split}.png", caption)
    if (table["split"] == "test").any() and {"rigid_body", best} <= set(table["method"]):
        drawn = figures.residuals(table, "test", best, f"{result.title}, what is missing before and after")
        caption = "Residual per joint on a held-out run: after the rigid body alone, and after the best model."
        yield _figure(page, drawn, folder / f"{result.name}_residual.png", caption)


def _section(page: _Page, section: Section, result: DatasetResults | None) -> None:
    level = 3 if result is not None else 2
    after = f" {html.badge(result.provenance)}" if result is not None else ""
    anchor = html.slug(f"{section.dataset}-{section.name}")
    page.heading(level, section.title, anchor, after)
    page.add(section.html)
    if section.loop is None:
        return
    content = section.loop
    if not section.evidence:
        content = replace(content, groups=tuple(replace(group, curves=()) for group in content.groups))
    for kind in STUDY_PART:
        part = kind(content, prefix=f"{anchor}-", light=True)
        if part.wanted:
            page.add(render_section(part, page.book, level + 1, heading=kind is not Answer))


def _closing(page: _Page, results: Sequence[DatasetResults], checked: Sequence[Check], study: StudyInputs) -> None:
    for section in study.sections:
        if not section.dataset:
            _section(page, section, None)
    for title, path in study.tables.items():
        if Path(path).exists():
            page.heading(2, title, title)
            page.add(pieces.frame_table(read_csv(Path(path))))
    if checked:
        page.heading(2, "Claims", "claims")
        page.add(
            "<p>What the paper and the loop set out to show, and the number that decides it. n: cases it was found on; "
            "a share counted on few cases decides nothing.</p>",
            pieces.check_table(checked),
        )
    timing = timing_table(results)
    if len(timing):
        page.heading(2, "Training time and memory", "timing")
        page.add(_timing(timing))
    page.heading(2, "Sources and licences", "sources")
    page.add(_sources(results))
    page.add("<footer>Every number here was computed from the result files by the stage <code>report</code>.</footer>")


def _timing(timing: pd.DataFrame) -> str:
    """A line a method, its time and memory on each dataset."""
    datasets = list(dict.fromkeys(timing["dataset"]))
    known = {(row["dataset"], row["method"]): row for row in timing.to_dict("records")}
    rows: list[list[html.Cell | str]] = []
    for method in dict.fromkeys(timing["method"]):
        name = "SINDy's library, reduced once" if method == "factorize" else label(method)
        line: list[html.Cell | str] = [html.Cell(escape(name), "text")]
        for dataset in datasets:
            own = known.get((dataset, method))
            line += ["–", "–"] if own is None else [f"{own['wall_s']:.1f}", f"{own['peak_memory_mb']:.0f}"]
        rows.append(line)
    heads = [f"{escape(name)}: {what}" for name in datasets for what in ("time [s]", "peak memory [MB]")]
    note = (
        "<p>Wall time and peak memory of each training. The SINDy methods start from the library that was reduced once "
        "for all of them; a layer on top of another method counts itself alone.</p>"
    )
    return note + html.table(["Method", *heads], rows)


def _sources(results: Sequence[DatasetResults]) -> str:
    parts = []
    for result in results:
        known = {**result.metadata, **result.source}
        lines = [
            f"<li>{escape(key.replace('_', ' '))}: {escape(str(known[key]))}</li>"
            for key in ("repository", "commit", "licence", "license", "notice", "citation", "reason", "tried")
            if known.get(key)
        ]
        body = "".join(lines) or "<li>made by this repository's own simulation</li>"
        parts.append(f"<h3>{escape(result.display_name)} {html.badge(result.provenance)}</h3><ul>{body}</ul>")
    parts.append(
        "<p class='note'>Robot descriptions and meshes: example-robot-data and the licences it ships. Recorded data is "
        "never redistributed; it is fetched from its source and verified.</p>"
    )
    return "\n".join(parts)
