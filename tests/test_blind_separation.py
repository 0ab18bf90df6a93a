"""The truth of the blind cases is out of reach of everything that diagnoses."""

from pathlib import Path

import yaml

STAGES = yaml.safe_load((Path(__file__).resolve().parents[1] / "dvc.yaml").read_text())["stages"]
TRUTH = "data/blind_truth"


def paths(stage: dict, key: str) -> list[str]:
    return [str(item) if not isinstance(item, dict) else next(iter(item)) for item in stage.get(key, [])]


def below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + "/") or folder.startswith(path + "/")


def test_only_the_scoring_stage_reads_the_truth():
    readers = {name for name, stage in STAGES.items() if any(below(p, TRUTH) for p in paths(stage, "deps"))}
    # The report reads all results, scores included: it comes after scoring.
    assert "score_blind" in readers
    assert readers <= {"score_blind", "report"}


def test_the_diagnosing_stage_tracks_neither_the_truth_nor_its_params():
    stage = STAGES["close_blind"]
    assert set(paths(stage, "params")) == {"loop"}
    assert not any(below(p, TRUTH) for p in paths(stage, "deps"))


def test_nothing_the_diagnosis_needs_comes_from_the_truth():
    """Walk up from close_blind: generate_blind alone may write both, and writes them to separate places."""
    outputs = {name: paths(stage, "outs") for name, stage in STAGES.items()}
    writers = [name for name, outs in outputs.items() if any(below(o, TRUTH) for o in outs)]
    assert writers == ["generate_blind"]
    assert not any(below(o, "data/blind") for o in outputs["generate_blind"] if o.startswith(TRUTH))


def test_the_diagnosing_stage_names_no_truth_in_its_code():
    code = (Path(__file__).resolve().parents[1] / "stages" / "close_blind.py").read_text()
    assert "truth" not in code
    assert "blind import" not in code.replace("layout import BlindFiles", "")


ADDED = "data/added_truth"


def test_what_was_added_to_recorded_runs_is_read_by_its_score_alone():
    readers = {name for name, stage in STAGES.items() if any(below(p, ADDED) for p in paths(stage, "deps"))}
    assert "score_added" in readers
    assert readers <= {"score_added", "report"}
    outputs = {name: paths(stage, "outs") for name, stage in STAGES.items()}
    assert [name for name, outs in outputs.items() if any(below(o, ADDED) for o in outs)] == ["generate_added"]
    # Nor does the stage that diagnoses know what kinds of effect are added, and how large.
    assert set(paths(STAGES["close_added"], "params")) == {"loop"}
    code = (Path(__file__).resolve().parents[1] / "stages" / "close_added.py").read_text()
    assert "truth" not in code
    assert "study.park" not in code
