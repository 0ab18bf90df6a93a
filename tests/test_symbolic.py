"""Symbolic regression: known truth in rounds, the contract of both engines, constants, safe expressions."""

import ast
import os
import sys
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from stages.common import dataset_argument

from hybrid_dynamics.errors import InputError, MissingDependencyError
from hybrid_dynamics.models import (
    CompiledExpressions,
    SymbolicEstimator,
    SymbolicSettings,
    format_expression,
    parse_expression,
    symbolic_regression,
)
from hybrid_dynamics.models.symbolic import Candidate, make_engine
from hybrid_dynamics.models.symbolic.julia import find_julia
from hybrid_dynamics.models.symbolic.pysr_engine import PySREngine, read_equations, regressor_options
from hybrid_dynamics.models.symbolic.refit import Pruning, bases_of, fit_constants, fit_terms
from hybrid_dynamics.models.symbolic.settings import best_candidate

NAMES = ["a", "b", "c", "d"]
QUICK = SymbolicSettings(evaluations=4000, population=200, batch=800)


@pytest.fixture(scope="module")
def inputs():
    return np.random.default_rng(5).normal(size=(2000, 4)) * np.array([1.0, 10.0, 0.1, 3.0])


def terms_of(expression):
    return {str(term): float(value) for term, value in expression.as_coefficients_dict().items()}


def check(expression, expected, rtol=1e-6):
    found = terms_of(expression)
    assert found.keys() == expected.keys()
    np.testing.assert_allclose([found[k] for k in expected], list(expected.values()), rtol=rtol)


def test_small_terms_are_found_in_rounds(inputs):
    """A term with 2e-5 of the variance, which one search passes over, and nothing beside it."""
    a, b, c, d = inputs.T
    y = 2.0 * b + 5.0 * a * d + 0.9 * c
    assert np.var(0.9 * c) < 3e-5 * np.var(y)
    result = symbolic_regression(inputs, y, NAMES, QUICK)
    check(result.expression, {"b": 2.0, "a*d": 5.0, "c": 0.9})
    assert result.share_explained > 1 - 1e-9


def test_what_is_below_the_stated_share_is_dropped(inputs):
    a, b, c, _ = inputs.T
    y = 2.0 * b + 2e-3 * a + 1e-3 * np.sin(20 * c)
    assert 1e-8 < np.var(2e-3 * a) / np.var(y) < 1e-6
    check(symbolic_regression(inputs, y, NAMES, QUICK).expression, {"b": 2.0}, rtol=1e-3)
    # Control: the same term above the share is kept.
    y = 2.0 * b + 0.2 * a + 1e-3 * np.sin(20 * c)
    check(symbolic_regression(inputs, y, NAMES, QUICK).expression, {"b": 2.0, "a": 0.2}, rtol=1e-3)


def test_nothing_is_found_where_nothing_is_left(inputs):
    """A residual that is small against the whole torque is not searched; noise of any size is not explained."""
    rng = np.random.default_rng(0)
    small = 2e-4 * rng.normal(size=len(inputs))
    assert symbolic_regression(inputs, small, NAMES, QUICK, variance=1.0).expression == 0
    noise = rng.normal(size=len(inputs))
    result = symbolic_regression(inputs, noise, NAMES, QUICK)
    assert abs(result.share_explained) < 0.05


def test_noise_buys_no_further_terms(inputs):
    rng = np.random.default_rng(1)
    y = 3.0 * inputs[:, 0] - 0.5 * inputs[:, 3] + 0.5 * rng.normal(size=len(inputs))
    found = terms_of(symbolic_regression(inputs, y, NAMES, QUICK).expression)
    assert found.keys() == {"a", "d"}
    # Five standard errors of a least-squares coefficient.
    assert abs(found["a"] - 3.0) < 5 * 0.5 / np.sqrt(len(y))


def test_the_front_is_kept(inputs):
    result = symbolic_regression(inputs, inputs[:, 0] * inputs[:, 1], NAMES, QUICK, joint=3)
    search = [row for row in result.front if row.kind == "search" and row.round == 1]
    assert sum(row.selected for row in search) == 1
    assert [row.complexity for row in search] == sorted(row.complexity for row in search)
    assert all(x.loss > y.loss for x, y in pairwise(search))
    assert {row.joint for row in result.front} == {3}
    last = [row for row in result.front if row.kind == "refit"][-1]
    assert last.selected
    assert parse_expression(last.expression, NAMES) == result.expression


def test_same_seed_same_model_whatever_the_workers():
    rng = np.random.default_rng(2)
    X = rng.normal(size=(600, 21))
    y = X[:, 3:6] * np.array([1.0, 2.0, 3.0]) + X[:, :3] ** 2 + 0.1 * rng.normal(size=(600, 3))
    settings = {"evaluations": 3000, "population": 200, "max_rounds": 2}
    one, two, other = (
        SymbolicEstimator(SymbolicSettings(workers=workers, seed=seed, **settings)).fit(X, y)
        for workers, seed in ((1, 0), (2, 0), (2, 9))
    )
    assert one.expressions_ == two.expressions_
    assert one.front_ == two.front_
    assert one.front_ != other.front_


ENGINES = [
    "operon",
    pytest.param("pysr", marks=pytest.mark.skipif(find_julia() is None, reason="PySR's engine needs Julia")),
]


@pytest.mark.parametrize("engine", ENGINES)
def test_engine_contract(engine, inputs):
    """A Pareto front over x0, x1, ...: losses are true mean squared errors, the truth is among them, repeatable."""
    X = inputs / inputs.std(axis=0)
    y = 1.5 * X[:, 0] * X[:, 1] - 0.7 * X[:, 2]
    wanted = SymbolicSettings(engine=engine, evaluations=20_000, batch=len(X), max_length=15)
    front = make_engine(wanted).search(X, y, wanted, 1)
    assert [c.complexity for c in front] == sorted({c.complexity for c in front})
    assert all(x.loss > y.loss for x, y in pairwise(front))
    names = [f"x{k}" for k in range(4)]
    for candidate in front:
        values = CompiledExpressions([candidate.expression], names)(X)[:, 0]
        assert np.mean((values - y) ** 2) == pytest.approx(candidate.loss, rel=1e-3, abs=1e-8)
    assert front[-1].loss < 1e-6
    assert front == make_engine(wanted).search(X, y, wanted, 1)


@pytest.fixture
def no_julia(monkeypatch, tmp_path) -> Path:
    """A machine without Julia; its PATH is the folder that is returned."""
    for variable in ("PYTHON_JULIAPKG_EXE", "PYTHON_JULIACALL_EXE"):
        # Set first, so that what the engine sets is undone.
        monkeypatch.setenv(variable, "x")
        monkeypatch.delenv(variable)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    return tmp_path


def julia_that(folder: Path, does: str) -> Path:
    """A program called julia that does something else."""
    program = folder / "julia"
    program.write_text(f"#!/bin/sh\n{does}\n")
    program.chmod(0o755)
    return program


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (None, r"needs Julia, and none was found; install Julia 1\.10\.3 or later .* or choose sr=operon"),
        ("echo julia version 1.10.3", None),
        ("echo julia version 1.10.0", None),
        ("echo julia version 1.12.1+0.x64", None),
        ("echo julia version 1.10.2", r"needs Julia 1\.10\.3 or later, and .*julia is 1\.10\.2"),
        ("echo julia version 1.9.4", r"is 1\.9\.4; install a later one"),
        ("echo no display; exit 1", r"is none that runs \(no display\)"),
        ("exit 0", r"is none that runs \(it says nothing\)"),
    ],
)
def test_julia_is_tried_before_any_work(no_julia, does, message):
    if does is not None:
        julia_that(no_julia, does)
    if message is None:
        engine = make_engine(SymbolicSettings(engine="pysr"))
        assert not engine.concurrent
        assert os.environ["PYTHON_JULIAPKG_EXE"] == find_julia() == str(no_julia / "julia")
        return
    with pytest.raises(MissingDependencyError, match=message) as error:
        make_engine(SymbolicSettings(engine="pysr"))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (None, "names no program; correct or unset it"),
        ("exit 1", "correct that variable"),
        ("echo julia version 1.6.0", "1.6.0"),
    ],
)
def test_the_variable_that_names_julia_is_named(no_julia, monkeypatch, does, message):
    if does is not None:
        julia_that(no_julia, does)
    monkeypatch.setenv("PYTHON_JULIAPKG_EXE", str(no_julia / "julia"))
    with pytest.raises(MissingDependencyError, match="PYTHON_JULIAPKG_EXE=") as error:
        make_engine(SymbolicSettings(engine="pysr"))
    assert message in str(error.value)


def stub(interrupted: bool = False, **more: object) -> SimpleNamespace:
    """A module as PySR is: a regressor that finds y = 2 x0, and Julia's answers."""

    class Regressor:
        def __init__(self, **options: object) -> None:
            self.options = options

        def fit(self, X: np.ndarray, y: np.ndarray, variable_names: list[str]) -> None:
            self.equations_ = pd.DataFrame({"complexity": [3], "loss": [0.0], "equation": ["x0 * 2.0"]})
            self.interrupted_ = interrupted

    jl = SimpleNamespace(seval=lambda code: "2.7.2" if "pkgversion" in code else "1.10.4")
    return SimpleNamespace(**({"PySRRegressor": Regressor, "jl": jl, "__version__": "1.2.3"} | more))


def engine_with(no_julia, monkeypatch, module: object) -> PySREngine:
    julia_that(no_julia, "echo julia version 1.10.4")
    monkeypatch.setitem(sys.modules, "pysr", module)
    return PySREngine()


def test_an_interrupted_search_is_no_model(no_julia, monkeypatch):
    X = np.random.default_rng(0).normal(size=(200, 21))
    settings = SymbolicSettings(engine="pysr", max_rounds=1)
    assert len(engine_with(no_julia, monkeypatch, stub()).search(X, X[:, 0], settings, 1)) == 1
    with pytest.raises(KeyboardInterrupt):
        engine_with(no_julia, monkeypatch, stub(interrupted=True)).search(X, X[:, 0], settings, 1)
    with pytest.raises(KeyboardInterrupt):
        SymbolicEstimator(settings).fit(X, 2 * X[:, :3])


def test_versions_and_progress_of_a_search(no_julia, monkeypatch):
    engine_with(no_julia, monkeypatch, stub())
    X = np.random.default_rng(0).normal(size=(200, 21))
    told: list[tuple[float, str]] = []
    settings = SymbolicSettings(engine="pysr", max_rounds=2)
    estimator = SymbolicEstimator(settings, lambda share, what: told.append((share, what))).fit(X, 2 * X[:, [0, 0, 0]])
    assert estimator.versions_ == {"pysr": "1.2.3", "julia": "1.10.4", "symbolic_regression": "2.7.2"}
    assert estimator.document({}, "")["versions"] == estimator.versions_
    assert SymbolicEstimator.from_document(estimator.document({}, ""), {}).versions_ == estimator.versions_
    assert told[-1] == (1.0, "round 6 of 6")
    assert told == sorted(told)
    assert len(told) > 3, "within a joint too"


def test_a_julia_that_cannot_start_is_one_line(no_julia, monkeypatch, tmp_path, capfd):
    """PythonCall and juliapkg come up with anything, after Julia has printed its own traceback."""
    package = tmp_path / "site" / "pysr"
    package.mkdir(parents=True)
    shout = "import os; os.system('for i in 1 2 3; do echo Stacktrace: >&2; done; echo ERROR: no network >&2')"
    (package / "__init__.py").write_text(f"{shout}\nraise Exception('Could not resolve\\nmany\\nlines')\n")
    julia_that(no_julia, "echo julia version 1.10.4")
    monkeypatch.delitem(sys.modules, "pysr", raising=False)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("PATH", f"{no_julia}{os.pathsep}/usr/bin{os.pathsep}/bin")
    X = np.zeros((10, 3))
    with pytest.raises(
        MissingDependencyError, match=r"PySR cannot start it: ERROR: no network; .*PYTHON_JULIAPKG_EXE"
    ) as error:
        PySREngine().search(X, X[:, 0], SymbolicSettings(engine="pysr"), 1)
    assert "\n" not in str(error.value)
    assert "Stacktrace" not in "".join(capfd.readouterr())


def test_the_first_stage_stops_where_julia_is_missing(no_julia, monkeypatch, capsys):
    monkeypatch.chdir(no_julia)
    Path("params.yaml").write_text("sr: {engine: pysr}\n")
    monkeypatch.setattr(sys, "argv", ["generate_sim", "panda"])
    with pytest.raises(MissingDependencyError, match="none was found"):
        dataset_argument("")
    Path("params.yaml").write_text("sr: {engine: operon}\n")
    assert dataset_argument("").dataset == "panda"


def test_pysr_knows_the_options_it_is_given():
    """Read from PySR's source, because importing it starts Julia."""
    source = Path(find_spec("pysr").origin).with_name("sr.py").read_text()  # type: ignore[union-attr]
    regressor = next(n for n in ast.parse(source).body if isinstance(n, ast.ClassDef) and n.name == "PySRRegressor")
    methods = {n.name: n.args for n in regressor.body if isinstance(n, ast.FunctionDef)}
    known = {a.arg for a in (*methods["__init__"].args, *methods["__init__"].kwonlyargs)}
    options = regressor_options(SymbolicSettings(operators=("add", "div", "sign")), 20_000, 1)
    assert options.keys() <= known
    assert options["binary_operators"] == ["+", "/"]
    assert options["unary_operators"] == ["sign"]
    assert options["batching"]
    assert options["batch_size"] == 10_000
    assert "variable_names" in {a.arg for a in (*methods["fit"].args, *methods["fit"].kwonlyargs)}


def test_pysr_table_is_translated():
    table = [
        {"complexity": 1, "loss": 3.0, "equation": "x1"},
        {"complexity": 3, "loss": 2.0, "equation": "x1 * 2.5"},
        {"complexity": 4, "loss": 2.5, "equation": "sin(x1) + 1"},
        {"complexity": 6, "loss": 0.5, "equation": "(x0 ^ 2.0) - (-1.5e-3 * sign(x1))"},
        {"complexity": 7, "loss": np.nan, "equation": "exp(x0)"},
        {"complexity": 8, "loss": 0.1, "equation": "abs(x0) * cos(x1 / 0.5)"},
    ]
    front = read_equations(table, ["x0", "x1"])
    assert [c.complexity for c in front] == [1, 3, 6, 8]
    X = np.array([[0.3, -2.0], [-1.5, 0.7]])
    values = CompiledExpressions([c.expression for c in front], ["x0", "x1"])(X)
    a, b = X.T
    expected = np.column_stack([b, 2.5 * b, a**2 + 1.5e-3 * np.sign(b), np.abs(a) * np.cos(b / 0.5)])
    np.testing.assert_allclose(values, expected, rtol=1e-14)
    with pytest.raises(InputError, match="open"):
        read_equations([{"complexity": 1, "loss": 1.0, "equation": "open(x0)"}], ["x0"])


def test_the_best_trade_is_selected():
    x = sp.Symbol("x")
    front = [Candidate(k, loss, x) for k, loss in ((1, 1.0), (3, 0.5), (5, 1e-6), (9, 0.9e-6), (20, 0.8e-6))]
    assert best_candidate(front).complexity == 5


@pytest.mark.slow
def test_sign_and_sine_are_found(inputs):
    a, _, _, d = inputs.T
    noise = 0.01 * np.random.default_rng(3).normal(size=len(a))
    extended = SymbolicSettings(
        operators=("add", "sub", "mul", "sign", "sin"), evaluations=20_000, population=300, batch=2000, max_length=15
    )
    result = symbolic_regression(inputs[:, [0, 3]], 2.0 * np.sign(d) + 0.5 * d + noise, ["a", "d"], extended)
    check(result.expression, {"sign(d)": 2.0, "d": 0.5}, rtol=1e-2)
    result = symbolic_regression(inputs[:, [0]], 1.3 * np.sin(2.2 * a) + noise, ["a"], extended)
    assert result.share_explained > 0.99


def test_inner_constants_by_gauss_newton():
    x = np.linspace(-2, 2, 400)[:, None]
    y = 1.7 * np.exp(-3.1 * x[:, 0] ** 2) + 0.4
    a = sp.Symbol("a", real=True)
    start = 1.0 * sp.exp(sp.Float(-2.0) * a**2) + sp.Float(0.1)
    found = fit_constants(start, x, y, ["a"])
    assert sorted(float(c) for c in found.atoms(sp.Float)) == pytest.approx([-3.1, 0.4, 1.7], rel=1e-6)


def test_dependent_and_useless_terms_fall(inputs):
    a, b = (sp.Symbol(s, real=True) for s in "ab")
    y = 2.0 * inputs[:, 0]
    fit = fit_terms([a * b, a, b, 3 * a, a + 1e-14 * b], inputs, y, NAMES, Pruning(1e-9, 0.0, 5))
    assert fit.bases == (a,)
    assert fit.coefficients == pytest.approx((2.0,))
    assert bases_of((a + 2) * (a - b)) == list(dict.fromkeys(bases_of(sp.expand((a + 2) * (a - b)))))


@settings(max_examples=60, deadline=None)
@given(
    coefficients=st.lists(st.floats(-1e6, 1e6, allow_subnormal=False), min_size=1, max_size=5),
    powers=st.lists(st.integers(0, 4), min_size=5, max_size=5),
)
def test_text_keeps_every_bit(coefficients, powers):
    a, b = sp.Symbol("a"), sp.Symbol("b")
    expression = sp.Add(
        *(sp.Float(c) * a**p * sp.sin(b) ** k for k, (c, p) in enumerate(zip(coefficients, powers, strict=False)))
    )
    again = parse_expression(format_expression(expression), ["a", "b"])
    assert sorted(again.atoms(sp.Float), key=float) == sorted(expression.atoms(sp.Float), key=float)
    X = np.random.default_rng(0).normal(size=(20, 2))
    one, two = (CompiledExpressions([e], ["a", "b"])(X) for e in (expression, again))
    np.testing.assert_allclose(one, two, rtol=1e-14, atol=0)
