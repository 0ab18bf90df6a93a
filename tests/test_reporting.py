"""The report: errors, tables, Table III, checks, page. Known truth is recovered; a control must fail."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.browser import look
from tests.reporting_study import DAMPING, write_dataset

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.files import write_json
from hybrid_dynamics.loop_report.content import Content, Curve, Group, write_content
from hybrid_dynamics.metrics import torque_errors
from hybrid_dynamics.study.claims import paper
from hybrid_dynamics.study.claims.checks import checks
from hybrid_dynamics.study.claims.coefficients import table_three
from hybrid_dynamics.study.evaluation import EvaluationSettings, PooledErrors, evaluate_predictions
from hybrid_dynamics.study.intervals import clopper_pearson
from hybrid_dynamics.study.report import (
    campaign_sections,
    derivative_section,
    loop_section,
    study_sections,
    write_report,
)
from hybrid_dynamics.study.report.pieces import best_beside_rigid_body
from hybrid_dynamics.study.report.tables import format_value, text_tables
from hybrid_dynamics.study.results import DatasetResults, Section, StudyInputs, read_dataset
from hybrid_dynamics.trajectory import Trajectory


def run(name: str, split: str, tau: np.ndarray) -> Trajectory:
    return Trajectory(name, split, np.arange(len(tau)) * 0.01, {"tau": tau, "q": np.zeros_like(tau)})


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.lists(st.integers(2, 60), min_size=1, max_size=5), st.floats(-1e4, 1e4))
def test_pool_equals_the_runs_laid_end_to_end(seed: int, lengths: list[int], offset: float) -> None:
    rng = np.random.default_rng(seed)
    taus = [offset + rng.standard_normal((length, 3)) for length in lengths]
    hats = [tau + 0.1 * rng.standard_normal(tau.shape) for tau in taus]
    pool = PooledErrors(3)
    for tau, hat in zip(taus, hats, strict=True):
        pool.add(tau, hat)
    expected = torque_errors(np.concatenate(taus), np.concatenate(hats))
    np.testing.assert_allclose(pool.errors().rmse, expected.rmse, rtol=1e-9)
    np.testing.assert_allclose(pool.errors().relative_rmse, expected.relative_rmse, rtol=1e-7)
    assert pool.errors().relative_error == pytest.approx(expected.relative_error, rel=1e-9)


def test_pool_of_a_torque_that_never_varies_has_no_relative_rmse() -> None:
    pool = PooledErrors(1)
    for _ in range(3):
        pool.add(np.zeros((5, 1)), np.ones((5, 1)))
    assert np.isnan(pool.errors().relative_rmse[0])
    assert np.isnan(pool.errors().relative_error)


def test_evaluation_holds_every_run_and_the_pool_and_thins_the_predictions() -> None:
    rng = np.random.default_rng(0)
    runs = [run(f"a{k}", split, rng.standard_normal((101, 2))) for k, split in enumerate(["train", "test", "test"])]
    predictors = {"zero": lambda t: np.zeros_like(t["tau"]), "true": lambda t: t["tau"]}
    result = evaluate_predictions(predictors, iter(runs), "d", "recorded", EvaluationSettings(points=20))
    keys = {(r.split, r.trajectory) for r in result.errors.itertuples()}
    assert keys == {("train", "a0"), ("train", "all"), ("test", "a1"), ("test", "a2"), ("test", "all")}
    assert len(result.errors) == 5 * 2 * 2
    zero = result.errors[result.errors["method"] == "zero"]
    assert zero["relative_error"].to_numpy() == pytest.approx(1.0)
    assert (result.errors[result.errors["method"] == "true"]["rmse"] == 0).all()
    assert set(result.predictions["trajectory"]) == {"a0", "a1"}
    assert result.predictions.groupby(["trajectory", "method"]).size().max() <= 20
    assert {"tau1", "tau_hat2", "time"} <= set(result.predictions.columns)


def test_evaluation_refuses_what_is_no_prediction() -> None:
    runs = [run("a", "test", np.ones((10, 2)))]
    with pytest.raises(InputError, match=r"method m, trajectory a: prediction has shape \(10, 1\); expected \(10, 2\)"):
        evaluate_predictions({"m": lambda t: np.zeros((10, 1))}, runs, "d", "recorded")
    with pytest.raises(InputError, match="joint 2 is nan at row 1"):
        evaluate_predictions({"m": lambda t: np.tile([0.0, np.nan], (10, 1))}, runs, "d", "recorded")
    with pytest.raises(InputError, match="no trajectory"):
        evaluate_predictions({"m": lambda t: t["tau"]}, [], "d", "recorded")
    with pytest.raises(ConfigError, match=r"evaluate.points is 1; expected"):
        EvaluationSettings(points=1)


def test_the_papers_tables_are_whole() -> None:
    for table in paper.ERROR_TABLES:
        assert len(table.rows) == 7
        assert {len(row) for row in table.rows} == {len(paper.COLUMNS)}
    assert paper.TABLE_II.value("nn", 7) == 1.356
    assert paper.TABLE_V.value("sindy", 5) == 60.189
    assert paper.TABLE_V.value("r_sindy_sr_published", 5) == 59.388
    assert paper.TABLE_I.value("least_squares", 1) is None
    assert paper.TABLE_I.value("sr", 8) is None
    for equations in paper.TABLE_III.values():
        assert sorted(equations) == list(range(1, 8))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "data"
    write_dataset(folder / "panda")
    return folder


@pytest.fixture(scope="module")
def panda(data: Path) -> DatasetResults:
    return read_dataset(data / "panda")


def with_expression(result: DatasetResults, method: str, joint: int, expression: str) -> DatasetResults:
    table = result.expressions.copy()
    rows = (table["method"] == method) & (table["joint"] == joint)
    table.loc[rows, "expression"] = expression
    return replace(result, expressions=table)


def test_table_three_finds_the_true_terms(panda: DatasetResults) -> None:
    entries = list(table_three(panda))
    assert len(entries) == 5 * 7
    assert all(entry.exact for entry in entries)
    assert panda.zero_torques == ("tau_gravity1",)
    first = next(entry for entry in entries if entry.method == "sr" and entry.joint == 1)
    assert "tau_gravity1" not in first.truth
    assert first.relative_error("dq1") == pytest.approx(1e-4, rel=1e-6)


def test_table_three_sees_a_wrong_term_a_missing_one_and_a_wrong_damping(panda: DatasetResults) -> None:
    extra = with_expression(panda, "r_sr", 3, "5.25*dq3 + 0.01*q2*dq1")
    entry = next(e for e in table_three(extra) if e.method == "r_sr" and e.joint == 3)
    assert entry.extra == ("dq1*q2",)
    assert not entry.exact
    missing = with_expression(panda, "sr", 2, "tau_inertia2 + 6.0*dq2 + tau_gravity2")
    assert next(e for e in table_three(missing) if e.method == "sr" and e.joint == 2).missing == ("tau_coriolis2",)
    off = with_expression(panda, "r_sr", 4, "4.55*dq4")
    verdicts = {check.claim: check.met for check in checks([off])}
    assert verdicts["Table III: every damping within 0.1 % of D"] is False
    assert [met for claim, met in verdicts.items() if "exactly the true terms" in claim] == [True]


def test_checks_are_met_by_the_truth_and_only_by_it(panda: DatasetResults) -> None:
    required = [check for check in checks([panda]) if check.met is not None]
    assert len(required) == 6
    assert all(check.met for check in required)
    worse = panda.errors.copy()
    worse.loc[worse["method"] == "sr", "relative_rmse"] *= 100
    failed = [check for check in checks([replace(panda, errors=worse)]) if check.met is False]
    assert {check.claim.rsplit(", ", 1)[1] for check in failed} == {"train", "test"}
    assert "(SR, joint" in failed[0].measured


def test_an_expression_too_long_to_read_is_counted_not_expanded(panda: DatasetResults) -> None:
    long = " + ".join(f"{k}.5*q1*dq{1 + k % 7}" for k in range(400))
    entry = next(e for e in table_three(with_expression(panda, "sr", 1, long)) if e.method == "sr" and e.joint == 1)
    assert entry.found is None
    assert entry.count == 400
    assert not entry.exact


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00021, "2.1e-4"), (0.0, "0.0000"), (0.0123456, "0.0123"), (0.5, "0.500"), (18.566, "18.6"), (123.4, "123"),
     (1.2e6, "1.2e6"), (float("nan"), "–"), (None, "–")],
)  # fmt: skip
def test_values_are_short(value: float | None, text: str) -> None:
    assert format_value(value) == text


def test_the_terminal_shows_tables_and_verdicts(panda: DatasetResults) -> None:
    text = text_tables([panda], checks([panda]))
    assert "panda (simulated): relative RMSE, test" in text
    assert "[met]" in text
    assert "NOT MET" not in text
    assert max(len(line) for line in text.splitlines() if line.startswith(" ") and "[" not in line) < 140


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write_dataset(folder / "data" / "wam", "simulated twin", runs=(1, 2))
    inputs = StudyInputs(
        folder / "data",
        ("wam",),
        titles={"wam": "Barrett WAM"},
        sections=(
            Section("loop", "The loop", "<p>LOOP FRAGMENT</p>", "wam"),
            Section("blind", "Blind cases", "<p>B</p>"),
        ),
    )
    write_report(replace(inputs, park=lost(folder / "park.csv")), folder / "reports")
    return folder / "reports"


def lost(path: Path) -> Path:
    """A table of the park in which the loop is surely worse than least squares on one joint."""
    rows = {"dataset": "tx40", "joint": [1, 2], "against_least_squares_verdict": ["better", "worse"]}
    whole = {"against_least_squares": 0.1, "arm_against_least_squares": 0.1, "arm_against_least_squares_error": 0.2}
    pd.DataFrame({**rows, **whole, "arm_against_least_squares_verdict": "as_good"}).to_csv(path, index=False)
    return path


def test_the_page_is_self_contained_and_says_where_the_data_is_from(report: Path) -> None:
    page = (report / "index.html").read_text("utf-8")
    assert not re.findall(r"(?:src|href)=[\"'](?!data:|#)", re.sub(r"(?s)<script.*?</script>", "", page))
    assert "@import" not in page
    assert "url(" not in page
    assert "Barrett WAM (simulated twin)" in page
    assert page.count('class="badge twin"') >= 3
    assert "Table IV." in page
    assert "paper 60.189" in page  # beside the scaled variant of the same method
    assert "paper 0.483" in page
    assert "LOOP FRAGMENT" in page
    assert page.index("LOOP FRAGMENT") < page.index("<p>B</p>")
    assert len(page) < 3_000_000
    # Whoever reads the count of claims reads which are not met, before any chapter.
    text = '<td class="text">([^<]*)</td>'
    missed = re.findall(rf'{text}{text}{text}<td>[^<]*</td><td class="text"><span class="missed">', page)
    assert "tx40 (recorded)" in [where for where, _, _ in missed]
    opening = page[: page.index('id="what-was-run"')]
    assert all(claim in opening and measured in opening for _, claim, measured in missed)
    assert page.index('id="sources"') > page.index('id="claims"') > page.index('id="wam"')
    for anchor in re.findall(r'href="#([^"]+)"', page):
        assert f'id="{anchor}"' in page


def test_files_for_the_acceptance_runs(report: Path) -> None:
    rmse = pd.read_csv(report / "rmse.csv")
    assert list(rmse.columns) == [
        "dataset",
        "provenance",
        "split",
        "trajectory",
        "method",
        "joint",
        "rmse",
        "relative_rmse",
    ]
    assert set(rmse["provenance"]) == {"simulated twin"}
    assert {"all", "test_0", "test_1", "train_0"} == set(rmse["trajectory"])
    pooled = pd.read_csv(report / "pooled.csv")
    assert list(pooled.columns) == ["dataset", "provenance", "split", "trajectory", "method", "relative_error"]
    assert not pooled.duplicated(["dataset", "split", "trajectory", "method"]).any()
    expressions = pd.read_csv(report / "expressions.csv")
    assert list(expressions.columns) == [
        "dataset",
        "provenance",
        "method",
        "joint",
        "engine",
        "expression",
        "complexity",
    ]
    metrics = json.loads((report / "metrics.json").read_text())
    assert metrics["wam"]["sr"]["worst_relative_rmse"] < 1e-3 < metrics["wam"]["nn"]["relative_error"]
    timing = pd.read_csv(report / "timing.csv")
    assert set(timing.columns) == {"dataset", "method", "wall_s", "peak_memory_mb"}
    assert {path.name for path in (report / "plots").iterdir()} == {"relative_rmse.csv", "fronts.csv", "held_out.csv"}
    assert not list(report.rglob("*.tmp*"))


def test_the_report_names_the_file_that_is_missing(tmp_path: Path, data: Path) -> None:
    with pytest.raises(InputError, match=r"errors.parquet: no such file; run the stage"):
        write_report(StudyInputs(tmp_path, ("panda",)), tmp_path / "reports")
    with pytest.raises(InputError, match="no dataset"):
        write_report(StudyInputs(data, ()), tmp_path / "reports")
    assert not (tmp_path / "reports").exists()


def test_sections_from_files(tmp_path: Path) -> None:
    folder = tmp_path / "data" / "ur10e"
    row = dict.fromkeys(("parameter", "expression", "unit"), "m1")
    numbers = dict.fromkeys(("described", "ordinary", "value", "std_error", "relative_std_percent"), None)
    lists = {key: [1.0] for key in ("armature", "viscous", "coulomb", "offset", "noise")}
    write_json(
        folder / "models" / "least_squares" / "model.json",
        {
            "rows": 10,
            "joints": ["a"],
            "condition_number": 5.0,
            "base_condition_number": None,
            "parameters": [row | numbers],
        }
        | lists,
    )
    write_json(folder / "differentiate.json", [{"trajectory": "r", "noise_std": [0.00271565, 0.1], "order": 4}])
    squares, derivatives = study_sections(("ur10e",), tmp_path / "data")
    assert "Condition number" in squares.html
    assert "0.002716, 0.1" in derivatives.html
    assert loop_section("x", tmp_path / "none") is None
    assert derivative_section(tmp_path / "none.csv") is None


def found(joints: tuple[str, ...] = ("a", "b")) -> Content:
    """A loop that named a payload and friction on joint b."""
    errors = [{"rmse": [v, v], "relative_rmse": [v / 10, v / 10], "relative_error": v / 10} for v in (3.1, 0.22)]
    change = dict(zip(("before", "after"), errors, strict=True))
    parameters = [{"name": "mass", "joint": None, "value": 2.81, "std_error": 0.0312, "unit": "kg"}]
    entry = {"settings": {}, "indistinguishable_from": [], "test_rmse_before": [3.1] * 2, "test_rmse_after": [0.2] * 2}
    torque = [{"name": "coulomb_torque", "joint": "b", "value": 1.5, "std_error": 0.1, "unit": "N m"}]
    effects = [
        {"effect": "payload", "joints": [], "parameters": parameters, **entry},
        {"effect": "coulomb_friction", "joints": ["b"], "parameters": torque, **entry},
    ]
    diagnosis = {
        "schema": 1, "robot": "arm", "joints": list(joints), "verdict": "explained", "effects": effects,
        "error": {"train": change, "test": change}, "noise_floor": [0.2, 0.2], "unexplained": [], "notes": [],
    }  # fmt: skip
    x = tuple(np.linspace(-1, 1, 900))
    law = Curve("b", "dq", 0.2, x, tuple(1.5 * np.sign(x)), tuple(1.5 * np.sign(x)), (0,) * 900)
    groups = (
        Group("b", "friction", (1,), (1.5,), ("b",), (law,)),
        Group("", "body", (0,), (3.0,), ("a",)),
    )
    return Content(diagnosis, ("train_1",), ("test_1",), groups)


def test_a_loop_is_shown_by_its_own_sections_and_a_question_without_its_curves(tmp_path: Path, data: Path) -> None:
    shutil.copytree(data / "panda", tmp_path / "data" / "panda")
    for place in ("models/loop", "questions/tool"):
        folder = tmp_path / "data" / "panda" / place
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "diagnosis.json", {})
        write_content(folder / "page.json", found())
    sections = study_sections(("panda",), tmp_path / "data")
    assert [section.name for section in sections] == ["loop", "question-tool"]
    study = StudyInputs(tmp_path / "data", ("panda",), sections=sections)
    page = write_report(study, tmp_path / "reports").read_text("utf-8")
    shown = re.sub(r"(?s)<(script|style).*?</\1>", "", page).replace("\u00a0", " ")
    assert shown.count("31 % to 2.2 % of the torque") == 2
    assert shown.count("Payload: mass 2.810 ± 0.031 kg") == 2
    assert shown.count('class="plot"') == 1
    assert len(json.loads(re.findall(r'id="plots">(.*?)</script>', page)[0])["figures"]) == 1
    ids = re.findall(r'\sid="([^"]+)"', shown)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', shown)) <= set(ids)
    for width, seen in look(page, (1100, 400)).items():
        assert seen.errors == seen.wide == seen.twice == seen.dead == []
        assert seen.scroll <= seen.width == width
        assert seen.drawn == seen.plots == 1


def test_a_loop_without_its_content_is_refused_by_name(tmp_path: Path) -> None:
    write_json(tmp_path / "diagnosis.json", {})
    with pytest.raises(InputError, match=r"page\.json: no such file; run the stage"):
        loop_section("x", tmp_path)


def test_derivative_accuracy_shows_the_best_method(tmp_path: Path) -> None:
    rows = [("tv", "dq", "all", 0.2, 0.19), ("tv", "dq", "1", 9.0, 9.0), ("spline", "dq", "all", 0.1, 0.09)]
    columns = ["method", "signal", "joint", "relative_rmse", "best_relative_rmse"]
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "d.csv", index=False)
    section = derivative_section(tmp_path / "d.csv")
    assert section is not None
    assert '<td class="best">0.1<small class="paper">best 0.09</small></td>' in section.html
    assert "9" not in re.sub(r"0\.\d+", "", section.html)


def test_a_joint_that_never_moves_and_no_held_out_run_are_reported(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data" / "custom", "recorded", runs=(1, 0))
    errors = pd.read_parquet(folder / "errors.parquet")
    errors.loc[errors["joint"] == 2, "relative_rmse"] = np.nan
    errors.to_parquet(folder / "errors.parquet")
    page = write_report(StudyInputs(tmp_path / "data", ("custom",)), tmp_path / "reports").read_text("utf-8")
    assert "On the training runs the rigid body alone" in page
    assert "<td>–</td>" in page
    write_dataset(tmp_path / "data" / "moved", "recorded", runs=(0, 1))
    result = read_dataset(tmp_path / "data" / "moved")
    errors = result.errors.copy()
    errors.loc[errors["joint"] == 2, "relative_rmse"] = np.nan
    html = best_beside_rigid_body(replace(result, errors=errors))
    assert "panda_joint1" in html
    assert "panda_joint2" not in html


def test_the_park_and_the_benchmarks_are_shown_where_their_tables_are(tmp_path: Path) -> None:
    assert campaign_sections(tmp_path) == ()
    park = [
        ("tx40", 1, 0.5, 9.0, 1.0, 0.9, 0.8, 0.99, "coulomb_friction"),
        ("tx40", 2, 0.1, 4.0, 1.0, 2.0, 0.5, None, None),
    ]
    columns = [
        "dataset",
        "joint",
        "floor",
        "rigid_body",
        "least_squares",
        "loop",
        "black_box",
        "explained_share",
        "named",
    ]
    pd.DataFrame(park, columns=columns).to_csv(tmp_path / "park.csv", index=False)
    rows = [("import", 0.3, None, None, "below 0.5 s", True), ("regressor", 0.2, 1.5, 7.5, "3 times", False)]
    pd.DataFrame(rows, columns=["name", "ours", "peer", "ratio", "goal", "met"]).to_csv(
        tmp_path / "benchmarks.csv", index=False
    )
    arms, benchmarks = campaign_sections(tmp_path)
    assert "Coulomb friction" in arms.html
    assert '<td class="best">0.9</td>' in arms.html  # the loop on joint 1
    assert '<td class="best">1</td>' in arms.html  # least squares on joint 2
    assert "99 %" in arms.html
    assert benchmarks.html.count("✓ met") == benchmarks.html.count("✗ not met") == 1


@pytest.mark.parametrize(
    ("hits", "cases", "low", "high"), [(0, 10, 0.0, 0.3085), (5, 10, 0.1871, 0.8129), (1, 1, 0.025, 1)]
)
def test_intervals_are_those_of_the_tables(hits: int, cases: int, low: float, high: float) -> None:
    assert clopper_pearson(hits, cases) == pytest.approx((low, high), abs=1e-4)


def test_held_out_motion_beyond_the_training_range_is_measured(panda: DatasetResults) -> None:
    assert panda.extrapolation is not None
    assert panda.extrapolation.distance > 0.5
    assert 0 < panda.extrapolation.outside <= 1
    assert float(DAMPING[0]) == 6.75
