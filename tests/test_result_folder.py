"""A result folder holds the old results or the new ones, never a mixture, whatever ends the run."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hybrid_dynamics import result_folder as module
from hybrid_dynamics.errors import InputError
from hybrid_dynamics.result_folder import check_result_folder, result_folder

OWN = ("a.json", "b.json")


def fill(folder: Path, text: str) -> None:
    for name in OWN:
        (folder / name).write_text(text)


def content(folder: Path) -> dict[str, str]:
    return {p.name: p.read_text() for p in folder.iterdir()}


def write(folder: Path, text: str, **options: bool) -> None:
    with result_folder(folder, OWN, **options) as new:
        fill(new, text)


@pytest.mark.parametrize("exchange", [True, False])
def test_new_results_replace_old_ones_and_nothing_is_left_beside(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(module, "_exchange", lambda a, b: False)
    out = tmp_path / "deep" / "out"
    write(out, "old")
    (out / "b.json").unlink()
    (out / "b.json").write_text("mixed")
    write(out, "new")
    assert content(out) == dict.fromkeys(OWN, "new")
    assert [p.name for p in out.parent.iterdir()] == ["out"]
    assert out.stat().st_mode & 0o777 == 0o777 & ~module._umask()


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(errno.ENOSPC, "No space left on device"), ValueError])
def test_an_error_leaves_the_old_results(tmp_path, error):
    out = tmp_path / "out"
    write(out, "old")

    def stopped() -> None:
        with result_folder(out, OWN) as new:
            (new / "a.json").write_text("new")
            raise error

    with pytest.raises(error if isinstance(error, type) else type(error)):
        stopped()
    assert content(out) == dict.fromkeys(OWN, "old")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_kill_between_two_steps_is_undone_by_the_next_run(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_exchange", lambda a, b: False)
    out = tmp_path / "out"
    write(out, "old")
    os.rename(out, module._aside(out))
    with pytest.raises(ValueError), result_folder(out, OWN):  # noqa: PT011
        raise ValueError
    assert content(out) == dict.fromkeys(OWN, "old")


def test_a_folder_that_is_not_ours_is_refused_and_kept_by_force(tmp_path):
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter.tex").write_text("years of work")
    (out / "figures").mkdir()
    (out / "figures" / "one.svg").write_text("<svg/>")
    with pytest.raises(InputError, match=r"thesis: holds chapter.tex and 1 more, .* --force"):
        check_result_folder(out, OWN, force=False)
    write(out, "new", force=True)
    assert (out / "chapter.tex").read_text() == "years of work"
    assert (out / "figures" / "one.svg").read_text() == "<svg/>"
    assert (out / "a.json").read_text() == "new"


def test_places_that_cannot_be_replaced_as_a_whole_are_refused(tmp_path, monkeypatch):
    inner = tmp_path / "here" / "inner"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    for place in (".", "..", inner):
        with pytest.raises(InputError, match="the working folder"):
            check_result_folder(place, OWN, force=True)
    write(tmp_path / "out", "old")
    with pytest.raises(InputError, match=r"a.json: is an input and would be overwritten"):
        check_result_folder(tmp_path / "out", OWN, [tmp_path / "out" / "a.json"], force=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: is a file"):
        check_result_folder(tmp_path / "file", OWN, force=True)


def test_a_link_keeps_pointing_to_the_results(tmp_path):
    write(tmp_path / "real", "old")
    (tmp_path / "link").symlink_to("real")
    write(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert content(tmp_path / "real") == dict.fromkeys(OWN, "new")


WRITER = """
import sys, time
from hybrid_dynamics.result_folder import result_folder
number = 0
while True:
    with result_folder(sys.argv[1], ("a.json", "b.json")) as new:
        for name in ("a.json", "b.json"):
            (new / name).write_text(str(number))
    number += 1
    if number == 2:
        print("writing", flush=True)
"""


def test_kills_at_random_moments_leave_whole_results(tmp_path):
    """Two writers at once, killed in the middle; a reader beside them never sees a mixture."""
    out = tmp_path / "out [1]"
    for moment in (0.0, 0.013, 0.031):
        writers = [
            subprocess.Popen([sys.executable, "-c", WRITER, str(out)], stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        for writer in writers:
            assert writer.stdout is not None
            writer.stdout.readline()
        time.sleep(moment)
        for writer in writers:
            writer.send_signal(signal.SIGKILL)
            writer.communicate()
        found = content(out)
        assert sorted(found) == sorted(OWN)
        assert len(set(found.values())) == 1, found
    write(out, "new")
    assert [p.name for p in tmp_path.iterdir()] == ["out [1]"], "what killed runs left was not cleared away"
