"""Bad inputs, all of them: one line, exit code 2, nothing half-written, and the page in docs/ says what comes out."""

import contextlib
import shutil

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.bad_inputs import CASES, PAGE, good, line_of, outcome, page
from tests.small_arm import arm

from hybrid_dynamics.errors import HybridDynamicsError
from hybrid_dynamics.loop.model import load_model
from hybrid_dynamics.readers.log import read_pieces
from hybrid_dynamics.robots import Robot

FEW = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    good(folder)
    return folder


@pytest.fixture(scope="module")
def rows():
    """Rows of the table, as the test of each case leaves them."""
    return {}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.what)
def test_one_line_the_exit_code_and_nothing_written(case, files, tmp_path, rows):
    folder = tmp_path / "here"
    shutil.copytree(files, folder)
    case.make(folder)
    before = {p: p.stat().st_size for p in folder.rglob("*")}
    code, out, err = outcome(case, folder)
    assert code == case.code
    assert sum(line.startswith("error:") for line in err.splitlines()) == (code != 0), err
    assert "Traceback" not in out + err
    assert {p: p.stat().st_size for p in folder.rglob("*")} == before
    line = line_of(case, out, err)
    assert "; " in line or ":" in line  # what is wrong, and what was expected or what to do
    rows[case.what] = (case, code, line)


def test_the_page_says_what_comes_out(rows):
    assert len(CASES) >= 120
    assert len({case.what for case in CASES}) == len(CASES)
    if len(rows) == len(CASES):  # not where a single case was asked for
        made = page([rows[case.what] for case in CASES])
        assert PAGE.read_text(encoding="utf-8") == made, "run: make pages"


def tried(read) -> None:
    """``read`` gives a result or one line; anything else is a bug."""
    with contextlib.suppress(HybridDynamicsError):
        read()


@FEW
@given(content=st.binary(max_size=400), suffix=st.sampled_from([".csv", ".parquet", ".mcap", ".bag", ".csv.gz"]))
def test_random_bytes_are_no_log_and_say_so(content, suffix, tmp_path):
    (tmp_path / f"x{suffix}").write_bytes(content)
    tried(lambda: read_pieces(tmp_path / f"x{suffix}", ("shoulder", "elbow"), notify=lambda line: None))


@FEW
@given(data=st.data())
def test_a_damaged_table_is_read_or_refused(data, files, tmp_path):
    text = "".join((files / "a.csv").read_text().splitlines(True)[:80])
    at = data.draw(st.integers(0, len(text)))
    change = data.draw(st.sampled_from(["cut", "insert", "drop"]))
    extra = data.draw(st.text(alphabet=st.characters(codec="utf-8"), max_size=5))
    damaged = {"cut": text[:at], "insert": text[:at] + extra + text[at:], "drop": text[:at] + text[at + 3 :]}[change]
    (tmp_path / "x.csv").write_text(damaged, encoding="utf-8")
    tried(lambda: read_pieces(tmp_path / "x.csv", ("shoulder", "elbow"), notify=lambda line: None))


@FEW
@given(data=st.data())
def test_a_damaged_model_is_read_or_refused(data, files, tmp_path):
    text = (files / "model.json").read_text()
    at = data.draw(st.integers(0, len(text) - 1))
    bits = st.sampled_from(["null", "true", "-1", "1e999", "[]", "{}", '"x"', "NaN", "0", ",", "}", "1e308"])
    kind = data.draw(st.sampled_from(["cut", "insert", "swap", "bytes"]))
    damaged = {
        "cut": text[:at],
        "insert": text[:at] + data.draw(bits) + text[at:],
        "swap": text.replace(
            data.draw(st.sampled_from(["3.0", "1.5", "2", '"elbow"', "[]", "null"])), data.draw(bits), 1
        ),
        "bytes": text[:at] + data.draw(st.text(max_size=3)) + text[at + 1 :],
    }[kind]
    (tmp_path / "m.json").write_bytes(damaged.encode("utf-8", errors="surrogatepass"))
    tried(lambda: load_model(tmp_path / "m.json", arm()))


@FEW
@given(data=st.data())
def test_a_damaged_urdf_is_read_or_refused(data, files, tmp_path):
    text = (files / "robot.urdf").read_text()
    at = data.draw(st.integers(0, len(text) - 1))
    until = at + data.draw(st.integers(0, 30))
    (tmp_path / "r.urdf").write_bytes(
        (text[:at] + data.draw(st.text(max_size=4)) + text[until:]).encode("utf-8", "ignore")
    )
    tried(lambda: Robot.from_urdf(tmp_path / "r.urdf"))
