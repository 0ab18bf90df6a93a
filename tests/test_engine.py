"""The same bytes from one process, from a pool and from a Dask cluster, also when a worker is killed."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.tests_support_engine import DeadlyOnce, die, refuse, squared

from hybrid_dynamics.engine import Cluster, Local, engine_of
from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.features import feature_names
from hybrid_dynamics.models.moments import moments
from hybrid_dynamics.models.partitioned import row_groups

#: Exponents of a constant, the 14 features and their squares.
POWERS = np.vstack([np.zeros((1, 14), int), np.eye(14, dtype=int), 2 * np.eye(14, dtype=int)])


def found_by(engine, chunks):
    return moments(chunks, POWERS, 100, engine)


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Two files of three row groups, two joints; the last row group is a test run."""
    folder, rng, paths = tmp_path_factory.mktemp("parts"), np.random.default_rng(0), []
    names = [*feature_names(2), "tau1", "tau2"]
    for k in range(2):
        columns = {name: rng.normal(size=690) for name in names}
        split = ["train"] * 460 + ["test" if k else "train"] * 230
        paths.append(folder / f"{k}.parquet")
        pq.write_table(pa.table({"split": split, **columns}), paths[-1], row_group_size=230)
    return paths


@pytest.fixture(scope="module")
def cluster():
    with Cluster(workers=2) as found:
        yield found


def test_a_row_group_is_a_chunk_and_test_runs_stay_out(parts):
    chunks = row_groups(parts)
    assert [(Path(c.path).name, c.group) for c in chunks] == [
        ("0.parquet", 0), ("0.parquet", 1), ("0.parquet", 2), ("1.parquet", 0), ("1.parquet", 1),
    ]  # fmt: skip


def test_every_engine_gives_the_same_bytes(parts, cluster):
    chunks = row_groups(parts)
    alone = found_by(Local(), chunks)
    assert alone.rows == 1150
    for engine in (Local(2), cluster):
        found = found_by(engine, chunks)
        assert found.R.tobytes() == alone.R.tobytes()
        assert found.variance.tobytes() == alone.variance.tobytes()
    # Control: another order of summation is another last digit, so the test above can see one.
    assert found_by(Local(), chunks[::-1]).R.tobytes() != alone.R.tobytes()


def test_a_killed_worker_changes_nothing(parts, cluster, tmp_path):
    chunks = row_groups(parts)
    deadly = [*chunks[:2], DeadlyOnce(chunks[2], str(tmp_path / "killed")), *chunks[3:]]
    found = found_by(cluster, deadly)
    assert (tmp_path / "killed").exists(), "no worker was killed"
    assert found.R.tobytes() == found_by(Local(), chunks).R.tobytes()


def test_a_killed_process_of_the_pool_is_told():
    with pytest.raises(InputError, match=r"worker process was killed.*fewer workers"):
        list(Local(2).map(die, range(4)))


def test_results_keep_their_tasks(cluster):
    for engine in (Local(), cluster):
        assert list(engine.map(squared, range(9))) == [x * x for x in range(9)]
        assert sorted(engine.unordered(squared, range(9))) == [(x, x * x) for x in range(9)]
        with pytest.raises(InputError, match="task 0 cannot be read"):
            list(engine.map(refuse, range(3)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"address": "tcp://10.0.0.5:8786"}, r"without encryption.*tls://"),
        ({"address": "cluster.example:8786"}, "without encryption"),
        ({"address": "tls://10.0.0.5:8786"}, "needs certificates"),
        (
            {"address": "tls://10.0.0.5:8786", "certificates": ("none.pem",) * 3},
            "none.pem: no such file",
        ),
        ({"workers": 0}, "workers is 0"),
    ],
)
def test_a_cluster_that_anybody_may_command_is_refused(given, message):
    with pytest.raises(ConfigError, match=message):
        Cluster(**given)


def test_a_cluster_of_our_own_listens_on_loopback_only(cluster):
    assert cluster._client.scheduler.address.startswith("tcp://127.0.0.1:")
    workers = cluster._client.scheduler_info()["workers"]
    assert len(workers) >= 1
    assert all(address.startswith("tcp://127.0.0.1:") for address in workers)


def test_unknown_engine_and_files_that_are_no_features_are_named(tmp_path):
    with pytest.raises(ConfigError, match="engine is 'spark'; expected one of local, dask"), engine_of("spark"):
        pass
    pq.write_table(pa.table({"tau1": [1.0], "q1": [0.0]}), tmp_path / "x.parquet")
    with pytest.raises(InputError, match=r"x\.parquet: has no column dq1"):
        row_groups([tmp_path / "x.parquet"])
    (tmp_path / "y.parquet").write_bytes(b"no")
    with pytest.raises(InputError, match=r"y\.parquet: not a readable Parquet file"):
        row_groups([tmp_path / "y.parquet"])
