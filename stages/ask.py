"""Stage ask_<dataset>: what changed since the model was calibrated? The loop, started from the calibrated model."""

import shutil
from dataclasses import replace

from hybrid_dynamics.errors import run_main
from hybrid_dynamics.loop import LoopSettings, close_loop, load_model
from hybrid_dynamics.loop_report.output import write_result
from hybrid_dynamics.robots import Robot
from hybrid_dynamics.study.config import load_params, section
from hybrid_dynamics.study.datasets import ReaderSettings, RecordedRun, TwinSettings, read_run, twin_runs
from hybrid_dynamics.study.sources import read_source
from hybrid_dynamics.trajectory import RECORDED, SIMULATED_TWIN, Trajectory
from stages.common import dataset_argument, progress_bar


def main() -> None:
    files = dataset_argument(__doc__)
    params = load_params()
    name = f"dataset.{files.dataset}"
    settings = section(params, "loop", LoopSettings)
    questions = section(params, f"{name}.questions", dict[str, list[RecordedRun]])
    robot = Robot.from_urdf(files.robot)
    start = load_model(files.model("loop") / "model.json", robot)
    recorded = read_source(files.source)["provenance"] == RECORDED

    def log(run: RecordedRun, question: str) -> list[Trajectory]:
        if recorded:
            return read_run(section(params, f"{name}.reader", ReaderSettings), run, files.source, robot, print)
        twin = replace(section(params, f"{name}.twin", TwinSettings), follow=())
        carrying = run.payload.added_to(robot) if run.payload is not None else robot
        seed = section(params, "seed", int) + 1 + list(questions).index(question)
        return [recording.recorded for recording in twin_runs(carrying, twin, [run], files.source, seed)]

    shutil.rmtree(files.questions, ignore_errors=True)
    for question, runs in questions.items():
        logs = [part for run in runs for part in log(run, question)]
        with progress_bar(f"{files.dataset}: {question}") as progress:
            result = close_loop(robot, logs, [], settings, start, progress)
        asked = {"command": {"stage": f"ask@{files.dataset}", "model": "models/loop/model.json"}}
        origin = RECORDED if recorded else SIMULATED_TWIN
        write_result(files.questions / question, result, asked, origin, keep_content=True)
        named = ", ".join(e.effect.effect for e in result.diagnosis.effects) or "nothing"
        print(f"{files.dataset}: {question}: {result.diagnosis.verdict}; named: {named}")


if __name__ == "__main__":
    run_main(main)
