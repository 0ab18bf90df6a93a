"""Two stages at a time: ``dvc repro`` runs one after the other, so data sets that share nothing get a lane each.

    python -m stages.lanes [--lanes 2] [--dry]

Stages fall into groups that no stage connects, once those that look at several data sets (report, track) are set aside.
Each group is one ``dvc repro``, ``--lanes`` of them at once; DVC stops a lane that needs what another one writes, so a
stage is never in two. Then plain ``dvc repro`` runs what was set aside, and whatever else is not up to date. It alone
does the same, one stage at a time.

Where all but what always runs is up to date that is run as it stands, without DVC, which reads the whole project anew
for each; only if it changes something the lanes begin.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterable

from hybrid_dynamics.errors import HybridDynamicsError, run_main

DVC = [sys.executable, "-m", "dvc"]
#: DVC gives up after three seconds where another process holds its lock, which on a busy machine two lanes that begin
#: together easily do.
REPRO = [*DVC, "--wait-for-lock", "repro"]
#: Seconds that an interrupted lane has to end its stage by itself.
PATIENCE = 20.0


def graph(text: str) -> dict[str, set[str]]:
    """Stage -> the stages that need what it writes, from what ``dvc dag --dot`` prints."""
    edges: dict[str, set[str]] = defaultdict(set)
    for line in text.splitlines():
        names = re.findall(r'"([^"]+)"', line)
        for name in names:
            edges[name]
        if "->" in line:
            edges[names[0]].add(names[1])
    return dict(edges)


def groups(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of stages that share nothing, the largest first; stages of several data sets (``stage@data``) left out."""
    sets: dict[str, set[str]] = {name: {name.partition("@")[2]} - {""} for name in edges}
    for name in _upstream_first(edges):
        for later in edges[name]:
            sets[later] |= sets[name]
    inside = [name for name in edges if len(sets[name]) <= 1]
    group = {name: name for name in inside}

    def root(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    for name in inside:
        for later in edges[name]:
            if later in group:
                group[root(later)] = root(name)
    found: dict[str, list[str]] = defaultdict(list)
    for name in inside:
        found[root(name)].append(name)
    return sorted((sorted(names) for names in found.values()), key=lambda names: (-len(names), names))


def _upstream_first(edges: dict[str, set[str]]) -> Iterable[str]:
    waiting = dict.fromkeys(edges, 0)
    for later in (b for others in edges.values() for b in others):
        waiting[later] += 1
    ready = [name for name, count in waiting.items() if count == 0]
    while ready:
        name = ready.pop()
        yield name
        for later in edges[name]:
            waiting[later] -= 1
            if waiting[later] == 0:
                ready.append(later)


def title(names: list[str]) -> str:
    return next((name.partition("@")[2] for name in names if "@" in name), names[0])


class Lanes:
    """Runs commands, some at a time; what they print comes line by line under their names."""

    def __init__(self, count: int) -> None:
        self.slots = threading.Semaphore(count)
        self.running: dict[str, subprocess.Popen[str]] = {}
        self.failed: list[str] = []
        self.stopped = False
        self.lock = threading.Lock()

    def run(self, commands: dict[str, list[str]]) -> None:
        """Run all; after a failure those under way end, the others are not begun. Ctrl-C ends all of them."""
        threads = [threading.Thread(target=self._one, args=pair, daemon=True) for pair in commands.items()]
        try:
            for thread in threads:
                thread.start()
            for thread in threads:
                while thread.is_alive():
                    thread.join(0.2)  # in slices: a bare join does not see Ctrl-C everywhere
        except BaseException:
            self.stop()
            raise

    def run_whole(self, commands: dict[str, list[str]]) -> None:
        """:meth:`run`; raises :class:`HybridDynamicsError` where one fails."""
        self.run(commands)
        if self.failed:
            raise HybridDynamicsError(f"failed: {', '.join(self.failed)}; what it said stands above")

    def _one(self, name: str, command: list[str]) -> None:
        with self.slots:
            with self.lock:
                if self.stopped or self.failed:
                    return
                # A group of its own: stages and their workers end with it, and Ctrl-C is ours to pass on.
                process = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
                )
                self.running[name] = process
            assert process.stdout is not None
            for line in process.stdout:
                print(f"{name}: {line}", end="", flush=True)
            if process.wait() and not self.stopped:
                self.failed.append(name)
            del self.running[name]

    def stop(self) -> None:
        """Interrupt every lane with all its processes; kill those that do not end."""
        with self.lock:
            self.stopped = True
            processes = list(self.running.values())
        for process in processes:
            _signal(process, signal.SIGINT)
        for process in processes:
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                _signal(process, signal.SIGKILL)


def only_what_always_runs() -> dict[str, list[str]] | None:
    """Commands of the stages that always run, by name, where no other one has anything to do; else None."""
    command = [*DVC, "--wait-for-lock", "status", "--json"]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    if asked.returncode:
        return None
    status: dict[str, list[object]] = json.loads(asked.stdout)
    if not status or any(reasons != ["always changed"] for reasons in status.values()):
        return None
    from dvc.repo import Repo  # a second to import

    commands = {stage.addressing: shlex.split(stage.cmd) for stage in Repo().index.stages if stage.addressing in status}
    # The interpreter that runs this one, wherever the path leads.
    return {name: [sys.executable, *words[1:]] if words[0] == "python" else words for name, words in commands.items()}


def _signal(process: subprocess.Popen[str], number: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=min(2, os.cpu_count() or 1), help="groups at once (default 2)")
    parser.add_argument("--dry", action="store_true", help="print the groups, run nothing")
    arguments = parser.parse_args()
    # SIGTERM (a closed terminal, a batch system) ends the lanes as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    if not arguments.dry and (waiting := only_what_always_runs()):
        Lanes(arguments.lanes).run_whole(waiting)
        if only_what_always_runs():
            print("Data and pipelines are up to date: only what always runs has been run.")
            return
    shown = subprocess.run([*DVC, "dag", "--dot"], capture_output=True, text=True, check=False)
    if shown.returncode:
        raise HybridDynamicsError(f"dvc dag failed: {(shown.stderr.strip().splitlines() or ['no message'])[-1]}")
    found = groups(graph(shown.stdout))
    if arguments.dry:
        for names in found:
            print(f"{title(names)}: {' '.join(names)}")
        return
    if arguments.lanes > 1 and len(found) > 1:
        Lanes(arguments.lanes).run_whole({title(names): [*REPRO, *names] for names in found})
    if subprocess.run(REPRO, check=False).returncode:
        raise HybridDynamicsError("dvc repro failed; what it said stands above")


if __name__ == "__main__":
    run_main(main)
