"""One factor serves every SINDy method: the same models as fits to the data itself."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models import (
    Factor,
    SindySettings,
    build_estimator,
    factorize,
    fit_factor,
    load_estimator,
    save_estimator,
)
from hybrid_dynamics.models.partitioned import row_groups
from hybrid_dynamics.models.sindy import factorize_chunks


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(3000, 14))
    names = feature_names(2)
    rigid = X[:, [8, 9]] + X[:, [10, 11]] + X[:, [12, 13]]
    y = rigid + 3.0 * X[:, [names.index("dq1"), names.index("dq2")]] + 0.01 * rng.normal(size=(3000, 2))
    return X, y


@pytest.mark.parametrize("method", ["sindy", "sindy_scaled", "r_sindy", "r_sindy_scaled"])
def test_same_model_as_the_direct_fit(data, method, tmp_path):
    X, y = data
    direct = build_estimator(method).fit(X, y)
    reduced = fit_factor(method, None, factorize(X, y, SindySettings()))
    np.testing.assert_allclose(reduced.predict(X), direct.predict(X), atol=1e-8)
    save_estimator(reduced, tmp_path)
    np.testing.assert_array_equal(load_estimator(tmp_path).predict(X), reduced.predict(X))


def test_residual_holds_friction_alone_and_the_torque_does_not(data):
    X, y = data
    factor = factorize(X, y, SindySettings())
    residual = fit_factor("r_sindy", None, factor)
    assert [str(e.free_symbols) for e in residual.residual.expressions()] == ["{dq1}", "{dq2}"]  # type: ignore[attr-defined]
    whole = fit_factor("sindy", None, factor)
    assert len(whole.expressions()[0].free_symbols) == 4  # type: ignore[index]


def test_files_in_parts_give_the_factor_of_the_whole(data, tmp_path):
    X, y = data
    names = [*feature_names(2), "tau1", "tau2"]
    table = pa.table(dict(zip(names, np.column_stack([X, y]).T, strict=True)))
    pq.write_table(table, tmp_path / "f.parquet", row_group_size=800)
    whole, parts = (
        factorize(X, y, SindySettings()),
        factorize_chunks(row_groups([tmp_path / "f.parquet"]), 14, SindySettings()),
    )
    assert parts.rows == whole.rows
    size = np.linalg.norm(whole.theta, axis=0)
    difference = (parts.theta.T @ parts.theta - whole.theta.T @ whole.theta) / size / size[:, None]
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)


def test_factor_survives_the_disk(data, tmp_path):
    factor = factorize(*data, SindySettings())  # type: ignore[call-arg]
    factor.save(tmp_path / "f.safetensors")
    back = Factor.load(tmp_path / "f.safetensors")
    np.testing.assert_array_equal(back.theta, factor.theta)
    assert back.rows == 3000


def test_missing_or_damaged_file_and_wrong_method_are_named(data, tmp_path):
    with pytest.raises(InputError, match="no such file; run the stage factorize"):
        Factor.load(tmp_path / "none")
    (tmp_path / "bad").write_bytes(b"12345678")
    with pytest.raises(InputError, match="not a readable factor"):
        Factor.load(tmp_path / "bad")
    with pytest.raises(ConfigError, match="expected a SINDy method"):
        fit_factor("r_nn", None, factorize(*data, SindySettings()))  # type: ignore[call-arg]
