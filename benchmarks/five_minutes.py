"""How long "your own robot in five minutes" takes: five arms that the study does not use, 4 runs of 16 s at 500 Hz.

    python -m benchmarks.five_minutes              # about ten minutes; writes docs/five_minutes.csv

Each arm gets a hidden friction on every joint and a payload; then the commands of docs/five-minutes.md run as a user
types them, each a process of its own: the loop with its report, and the exports. Measured are processor and wall time
of the processes, their peak memory, and whether what was hidden was named. Times hold for the machine they were taken
on; its load at the time stands beside them.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hybrid_dynamics.effects import Effect
from hybrid_dynamics.files import atomic_path
from hybrid_dynamics.readers import write_log
from hybrid_dynamics.robots import Robot, find_description, lock_joints
from hybrid_dynamics.simulation.excitation import excitations

#: Five minutes [s].
GOAL = 300.0
#: Arms of example-robot-data, joints that are fixed (grippers).
ARMS = {
    "kinova": ("kinova_description/robots/kinova.urdf", ()),
    "z1": ("z1_description/urdf/z1.urdf", ("jointGripper",)),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", ()),
    "talos_left_arm": ("talos_data/robots/talos_left_arm.urdf", ("gripper_left_joint",)),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", ()),
}
FORMATS = {"urdf": "urdf", "mjcf": "xml", "c": "c", "python": "py", "casadi": "casadi"}
#: Friction in shares of the joint's effort limit, payload in shares of the arm's mass.
COULOMB, VISCOUS, PAYLOAD = 0.03, 0.03, 0.05
TARGET = Path(__file__).resolve().parents[1] / "docs" / "five_minutes.csv"


@dataclass(frozen=True)
class Spent:
    """Processor time and wall time [s] and peak memory [MB] of one command."""

    cpu: float
    wall: float
    memory: float


def hidden_in(robot: Robot) -> list[Effect]:
    """Coulomb friction on every joint, viscous friction on every other, and a body at the flange."""
    out = []
    for j, (name, effort) in enumerate(zip(robot.joint_names, robot.effort_limits, strict=True)):
        out.append(Effect("coulomb_friction", (name,), {"coulomb_torque": COULOMB * float(effort)}))
        if j % 2 == 0:
            out.append(Effect("viscous_friction", (name,), {"viscous_coefficient": VISCOUS * float(effort)}))
    mass = PAYLOAD * sum(body.mass for body in robot.model.inertias)
    body = {"mass": mass, "com_x": 0.02, "com_y": 0.0, "com_z": 0.06}
    inertia = {f"inertia_{k}": 0.001 * mass if k[0] == k[1] else 0.0 for k in ("xx", "xy", "yy", "xz", "yz", "zz")}
    return [*out, Effect("payload", (), body | inertia)]


def run(command: Sequence[str]) -> Spent:
    """Run a command to its end; raises where it fails."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}")
    return Spent(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1024)


def measure(arm: str, folder: Path) -> dict[str, object]:
    """One row: what the commands took and what they found."""
    description, locked = ARMS[arm]
    urdf = folder / "robot.urdf"
    urdf.write_text(lock_joints(find_description(description), locked), "utf-8")
    robot = Robot.from_urdf(urdf)
    hidden = hidden_in(robot)
    runs = {}
    for split, logs in zip(("train", "test"), excitations(robot, hidden, train=3, test=1), strict=True):
        runs[split] = [folder / f"{log.name}.parquet" for log in logs]
        for path, log in zip(runs[split], logs, strict=True):
            write_log(path, log, robot.joint_names)
    load = os.getloadavg()[0]
    ours = [str(Path(sys.executable).with_name("hybrid-dynamics"))]
    out = folder / "result"
    at = ["--robot", str(urdf)]
    given = ["--train", *map(str, runs["train"]), "--test", *map(str, runs["test"])]
    # What the description declares as friction is not in these runs; hidden is what they hold, and nothing else.
    loop = run([*ours, "close-loop", "--quiet", "--ignore-dynamics", *at, *given, "--out", str(out)])
    model = ["--model", str(out / "model.json"), *at]
    exports = [
        run([*ours, "export", "--quiet", *model, "--format", name, "--out", str(folder / f"completed_{name}.{ending}")])
        for name, ending in FORMATS.items()
    ]
    found = json.loads((out / "diagnosis.json").read_text("utf-8"))
    named = {(e["effect"], *e["joints"]) for e in found["effects"] if e.get("confirmed", True)}
    truth = {(e.effect, *e.joints) for e in hidden}
    test = found["error"]["test"]
    after = test.get("after_confirmed", test["after"])
    wall = loop.wall + sum(e.wall for e in exports)
    spent = loop.cpu + sum(e.cpu for e in exports)
    return {
        "arm": arm,
        "joints": robot.n_joints,
        "loop_cpu_s": round(loop.cpu, 1),
        "loop_wall_s": round(loop.wall, 1),
        "exports": len(exports),
        "exports_cpu_s": round(sum(e.cpu for e in exports), 1),
        "exports_wall_s": round(sum(e.wall for e in exports), 1),
        "cpu_s": round(spent, 1),
        "wall_s": round(wall, 1),
        "goal_s": GOAL,
        # One process after the other, each on one core: alone on a machine the wall time is the processor time.
        "met": "yes" if spent <= GOAL else "no",
        "peak_memory_mb": round(max(loop.memory, *(e.memory for e in exports))),
        "verdict": found["verdict"],
        "hidden": len(truth),
        "named_right": len(named & truth),
        "named_besides": "; ".join(" ".join(name) for name in sorted(named - truth)),
        "held_out_error_before": f"{test['before']['relative_error']:.4g}",
        "held_out_error_after": f"{after['relative_error']:.4g}",
        "load_before": round(load, 1),
        "processors": os.cpu_count(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", nargs="*", choices=list(ARMS), default=list(ARMS), help="these alone")
    parser.add_argument("--out", type=Path, default=TARGET)
    args = parser.parse_args()
    rows = []
    for arm in args.arms:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measure(arm, Path(folder)))
        print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    with atomic_path(args.out) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(args.out)


if __name__ == "__main__":
    main()
