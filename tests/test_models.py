"""Estimators as compositions, and models on disk."""

import json

import numpy as np
import pytest
import sympy as sp

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models import (
    CompiledExpressions,
    HybridEstimator,
    NetworkEstimator,
    NetworkSettings,
    RigidBody,
    SindyEstimator,
    SindySettings,
    SymbolicSettings,
    build_estimator,
    load_estimator,
    save_estimator,
)
from hybrid_dynamics.models.methods import METHODS, Layer, Method, _table, layered

DAMPING = np.array([3.0, 0.5])
QUICK = {
    "sr": SymbolicSettings(evaluations=4000, population=200, batch=1000, max_rounds=3),
    "nn": NetworkSettings(hidden=(16,), epochs=3, batch_size=128, learning_rate=1e-2),
}


@pytest.fixture(scope="module")
def arm():
    """Features (N, 14) and torque (N, 2) of a made-up two-joint arm with viscous damping, exact."""
    rng = np.random.default_rng(7)
    X = rng.normal(size=(1500, 14)) * np.repeat([1.0, 1.0, 2.0, 5.0, 3.0, 1.0, 10.0], 2)
    y = X[:, 8:10] + X[:, 10:12] + X[:, 12:14] + DAMPING * X[:, 2:4]
    return X, y


def test_rigid_body_sums_its_three_torques(arm):
    X, y = arm
    model = RigidBody().fit(X, y)
    np.testing.assert_array_equal(model.predict(X), X[:, 8:10] + X[:, 10:12] + X[:, 12:14])


def test_hybrid_hands_the_residual_what_the_base_leaves(arm):
    X, y = arm

    class Spy:
        def fit(self, X, y, variance=None):
            self.seen, self.variance = y, variance
            return self

        def predict(self, X):
            return np.full((len(X), 2), 2.0)

    spy = Spy()
    model = HybridEstimator(RigidBody(), spy).fit(X, y)
    np.testing.assert_allclose(spy.seen, DAMPING * X[:, 2:4], atol=1e-12)
    np.testing.assert_allclose(spy.variance, y.var(axis=0))
    np.testing.assert_allclose(model.predict(X) - RigidBody().predict(X), 2.0)


@pytest.mark.parametrize("method", ["sr", "r_sr", "sindy_scaled", "r_sindy_scaled", "r_sindy_sr"])
def test_method_holds_exactly_the_true_terms(arm, method):
    X, y = arm
    model = build_estimator(method, QUICK).fit(X, y)
    rigid = ["tau_inertia", "tau_coriolis", "tau_gravity"] if not method.startswith("r_") else []
    for j, expression in enumerate(model.expressions(), start=1):
        terms = expression.as_coefficients_dict()
        terms = {str(term): float(value) for term, value in terms.items()}
        expected = {f"{name}{j}": 1.0 for name in rigid} | {f"dq{j}": DAMPING[j - 1]}
        assert terms.keys() == expected.keys()
        np.testing.assert_allclose([terms[k] for k in expected], list(expected.values()), rtol=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)


def test_a_wrong_structure_is_not_found(arm):
    """Control: with the damping on the other joint's velocity the same check must see other terms."""
    X, _ = arm
    y = RigidBody().predict(X) + DAMPING * X[:, [3, 2]]
    model = build_estimator("r_sindy_scaled", QUICK).fit(X, y)
    assert [str(e.free_symbols) for e in model.expressions()] == ["{dq2}", "{dq1}"]  # type: ignore[union-attr]


def test_fitted_base_is_not_fitted_again(arm):
    X, y = arm
    base = build_estimator("r_sindy_scaled", QUICK).fit(X, y)
    before = base.residual.coef_  # type: ignore[attr-defined]
    model = build_estimator("r_sindy_sr", QUICK, base=base).fit(X, y)
    assert base.residual.coef_ is before  # type: ignore[attr-defined]
    again = build_estimator("r_sindy_sr", QUICK).fit(X, y)
    np.testing.assert_array_equal(model.predict(X), again.predict(X))


@pytest.mark.parametrize("method", ["rigid_body", *layered()])
def test_round_trip_predicts_the_same_bits(arm, method, tmp_path):
    X, y = arm
    y = y + 0.3 * np.sin(X[:, :2])
    model = build_estimator(method, QUICK).fit(X, y)
    save_estimator(model, tmp_path / "a")
    again = load_estimator(tmp_path / "a")
    np.testing.assert_array_equal(again.predict(X), model.predict(X))
    assert again.expressions() == model.expressions()
    assert again.front() == model.front()
    save_estimator(again, tmp_path / "b")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()
    # Whoever may read one of the two files may read the other.
    assert len({file.stat().st_mode for file in (tmp_path / "a").iterdir()}) == 1


def test_arrays_stored_by_columns_come_back_in_their_places(arm, tmp_path):
    X, y = arm
    settings = NetworkSettings(hidden=(4, 3), epochs=1)
    model = NetworkEstimator(settings).fit(X, y)
    straight = {name: values.copy() for name, values in model.weights_.items()}
    model.weights_ = {name: np.asfortranarray(values) for name, values in straight.items()}
    assert not model.weights_["0.weight"].flags.c_contiguous
    save_estimator(model, tmp_path)
    again = load_estimator(tmp_path)
    for name, values in straight.items():
        np.testing.assert_array_equal(again.weights_[name], values)  # type: ignore[attr-defined]


def test_expressions_are_the_model(arm):
    X, y = arm
    y = y + 0.3 * np.sin(X[:, :2])
    names = feature_names(2)
    for method in ("sindy", "r_sindy_sr_published"):
        model = build_estimator(method, QUICK).fit(X, y)
        values = CompiledExpressions(model.expressions(), names)(X)
        rigid = RigidBody().predict(X) if method.startswith("r_") else 0.0
        np.testing.assert_allclose(values + rigid, model.predict(X), rtol=1e-9, atol=1e-9)
    assert build_estimator("r_nn", QUICK).expressions() is None


def test_network_same_seed_same_weights_and_it_learns(arm):
    X, y = arm
    settings = NetworkSettings(hidden=(32, 32), epochs=15, batch_size=64, learning_rate=1e-2, seed=3)
    seen = []
    first = NetworkEstimator(settings, lambda share, what: seen.append(share)).fit(X, y)
    second = NetworkEstimator(settings).fit(X, y)
    other = NetworkEstimator(NetworkSettings(hidden=(32, 32), epochs=15, batch_size=64, learning_rate=1e-2, seed=4))
    assert all(np.array_equal(first.weights_[k], second.weights_[k]) for k in first.weights_)
    assert not np.array_equal(other.fit(X, y).weights_["0.weight"], first.weights_["0.weight"])
    assert seen == [k / 15 for k in range(1, 16)]
    assert first.losses_[-1] < 0.05 * first.losses_[0]
    assert np.mean((first.predict(X) - y) ** 2) < 0.1 * y.var()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("__import__('os').system('true')", "model.json: .*holds"),
        ("eval(1)", "calls 'eval'"),
        ("dq1.__class__", "holds"),
        ("q9 + 1", "q9"),
        ("exp(dq1, 2)", "holds"),
        ("dq1 if 1 else 2", "holds"),
    ],
)
def test_a_stored_expression_cannot_run_code(arm, tmp_path, text, expected):
    X, y = arm
    save_estimator(build_estimator("r_sr", QUICK).fit(X, y), tmp_path)
    file = tmp_path / "model.json"
    document = json.loads(file.read_text())
    document["model"]["residual"]["expressions"][0] = text
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=expected):
        load_estimator(tmp_path)


def test_unusable_models_are_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"no such file.*train"):
        load_estimator(tmp_path)
    file = tmp_path / "model.json"
    for text, expected in (("{", "not a readable"), ('{"schema": 99}', "schema is 99"), ('{"schema": 1}', "damaged")):
        file.write_text(text)
        with pytest.raises(InputError, match=expected):
            load_estimator(tmp_path)


def test_bad_data_is_refused_by_name(arm):
    X, y = arm
    bad = X.copy()
    bad[3, 4] = np.nan
    with pytest.raises(InputError, match="row 4, column 5"):
        SindyEstimator().fit(bad, y)
    with pytest.raises(InputError, match="7 per joint"):
        RigidBody().fit(X[:, :-1], y)
    with pytest.raises(InputError, match="as many"):
        RigidBody().fit(X[:-1], y)


@pytest.mark.parametrize(
    "make",
    [
        lambda: SindySettings(threshold=-1.0),
        lambda: SindySettings(chunk_rows=0),
        lambda: NetworkSettings(hidden=()),
        lambda: NetworkSettings(learning_rate=0.0),
        lambda: SymbolicSettings(engine="eureqa"),
        lambda: SymbolicSettings(operators=("add", "frobnicate")),
        lambda: SymbolicSettings(operators=("sin",)),
        lambda: SymbolicSettings(drop_share=1.5),
        lambda: build_estimator("svm"),
        lambda: build_estimator("sindy", {"sindy": SindySettings(scaled=True)}),
    ],
)
def test_settings_out_of_range_are_refused(make):
    with pytest.raises(ConfigError, match="expected"):
        make()


def test_symbols_are_plain(arm):
    X, y = arm
    for expression in build_estimator("r_sr", QUICK).fit(X, y).expressions():  # type: ignore[union-attr]
        assert all(symbol == sp.Symbol(symbol.name) for symbol in expression.free_symbols)


def entry(name: str, home: str = "", below: str | None = None) -> Method:
    return Method(name, name, "", "residual", Layer("x", home, "x") if home else None, below)


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        ([entry("a"), entry("a")], "'a' stands twice"),
        ([entry("b", "m:C", below="a")], "'b' is built on 'a'; expected a layer on another method"),
        ([entry("a"), entry("b", below="a")], "'b' is built on 'a'; expected a layer"),
        ([entry("a", "m:C", below="b"), entry("b", "m:C", below="a")], "is built on"),
    ],
)
def test_a_method_that_cannot_be_is_refused(methods, message):
    with pytest.raises(ConfigError, match=message):
        _table(*methods)


@pytest.mark.parametrize("home", ["hybrid_dynamics.models.nowhere:C", "hybrid_dynamics.models.sindy:Nothing"])
def test_an_unknown_layer_is_refused(home):
    with pytest.raises(ConfigError, match="cannot be imported"):
        Layer("x", home, "x").estimator()


def test_every_method_has_a_label_and_a_sentence_of_its_own():
    assert len({m.label for m in METHODS.values()}) == len({m.what for m in METHODS.values()}) == len(METHODS)
