"""The sections of a loop's page that prove and document: evidence, torque, what is left, errors, search, origin."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_dynamics.effects.units import with_unit
from hybrid_dynamics.loop_report import plots, rest, words
from hybrid_dynamics.loop_report.book import FigureBook
from hybrid_dynamics.loop_report.content import AXES, KINDS, Law, SearchStep
from hybrid_dynamics.loop_report.sections import LEFT, Answer, Effects, LoopSection, range_of

#: Points of a curve on a page over many loops.
LIGHT_POINTS = 200


class Evidence(LoopSection):
    """For each group of effects: what is missing without them, over the variable that explains it."""

    title = "Evidence: the laws against held-out runs"
    name = "evidence"
    template = "evidence.html"

    @property
    def wanted(self) -> bool:
        return any(group.curves for group in self.content.groups)

    def values(self, book: FigureBook) -> dict[str, Any]:
        shown = []
        for group in self.content.groups:
            if not group.curves:
                continue
            names = [self.diagnosis["effects"][k] for k in group.effects]
            kept = [e for e in names if words.confirmed(e)] or names
            figures = []
            for curve in group.curves[:1] if self.light else group.curves:
                title = f"{curve.joint}: {', '.join(words.title_of(e['effect']) for e in kept)}"
                runs = "training" if group.runs else "held-out"
                alt = (
                    f"{title}. Points: torque missing on {runs} runs without these effects; line: what they "
                    f"add, over {curve.axis}; band: twice the noise floor of {words.number(curve.noise, 2)} "
                    f"{words.effort_unit(self.diagnosis, curve.joint)}."
                )
                curve = curve.thinned(LIGHT_POINTS) if self.light else curve
                slides = curve.joint in words.slides(self.diagnosis)
                heading = curve.joint if len(group.curves) > 1 else ""
                figure = plots.curve_figure(curve, group.runs or self.content.test_runs, heading, slides)
                figures.append(book.add(figure, alt, plots.CURVE_HEIGHT))
            shown.append(
                {
                    "anchor": self.group_anchor(group),
                    "title": f"{group.where or 'Whole robot'}: {KINDS[group.kind].lower()}",
                    "effects": [
                        {"anchor": "#" + self.effect_anchor(e), "title": words.capital(words.title_of(e["effect"]))}
                        for e in kept
                    ],
                    "figures": figures,
                }
            )
        return {
            "groups": shown,
            "runs": self.content.test_runs,
            "in_all": any(e.get("in_all") for e in self.diagnosis["effects"]),
        }


class Torque(LoopSection):
    """Torque of held-out runs: measured, both models, and what is left beneath."""

    title = "Torque of held-out runs"
    name = "torque"
    template = "torque.html"

    @property
    def wanted(self) -> bool:
        return bool(self.content.traces)

    def values(self, book: FigureBook) -> dict[str, Any]:
        floors = dict(zip(self.diagnosis["joints"], self.diagnosis["noise_floor"], strict=True))
        runs = list(dict.fromkeys(trace.run for trace in self.content.traces))[: 1 if self.light else None]
        height = plots.TORQUE_HEIGHT + plots.STRIP_HEIGHT
        slide = words.slides(self.diagnosis)
        return {
            "runs": [
                {
                    "run": words.capital(words.run_words(run)),
                    "figures": [
                        book.add(
                            plots.torque_figure(trace, floors[trace.joint], trace.joint in slide),
                            f"Torque of {trace.joint}, held-out {words.run_words(run)}: measured, model before, model "
                            "after, and below what is left.",
                            height,
                        )
                        for trace in self.content.traces
                        if trace.run == run
                    ],
                }
                for run in runs
            ],
            "others": [run for run in self.content.test_runs if run not in runs],
        }


class Left(LoopSection):
    """What no effect explains, with a formula; what cannot be told apart; motion outside the training range."""

    title = "What stays open"
    name = LEFT
    template = "left.html"

    @property
    def wanted(self) -> bool:
        return words.opens(self.diagnosis)

    def values(self, book: FigureBook) -> dict[str, Any]:
        d = self.diagnosis
        outside = d.get("extrapolation") or []
        return {
            "unexplained": [
                {
                    "joint": u["joint"],
                    "share": _how_much(d, u),
                    "state": rest.state_of(d, list(d["joints"]).index(u["joint"]))[1],
                    "expression": "" if u["expression"] == "0" else u["expression"],
                    "worth": _worth(d, self.content.laws, u["joint"]),
                }
                for u in d["unexplained"]
            ],
            "alike": [
                {"name": words.capital(name), "others": others, "motion": motion}
                for name, others, motion in words.alike(d, by_motion=True)
            ],
            "numbers": [words.capital(phrase) for phrase in words.open_numbers(d)],
            "outside": [
                {
                    "joint": o["joint"],
                    "variable": AXES.get(o["variable"], f"{o['variable']} [{words.unit_of(o['unit'])}]"),
                    "train_text": " to ".join(words.number(v, 3) for v in o["train"]),
                    "test_text": " to ".join(words.number(v, 3) for v in o["test"]),
                    "share": words.share(o["share_outside"]),
                }
                for o in outside
                if isinstance(o, Mapping)
            ],
        }


class Errors(LoopSection):
    """Every error measure per joint, with units."""

    title = "Errors in full"
    name = "errors"
    template = "errors.html"

    def values(self, book: FigureBook) -> dict[str, Any]:
        d = self.diagnosis
        refused = any(not words.confirmed(e) for e in d["effects"])
        tables = []
        for of, split, caption in (
            ("error", "test", "Held-out runs, all samples"),
            ("error_moving", "test", "Held-out runs, samples in which the joint moves"),
            ("error", "train", "Training runs, all samples"),
        ):
            if of in d:
                tables.append({"caption": caption, "rows": _error_rows(d, of, split), "pooled": _pooled(d, of, split)})
        diagnostics = [
            {
                "joint": with_unit(name, words.slides(d)),
                "floor": range_of((d.get("noise_floor_low") or floor)[j], (d.get("noise_floor_high") or floor)[j]),
                "learnable": words.share((d.get("learnable_share") or [None] * len(floor))[j]),
                "memory": words.number((d.get("autocorrelation") or [None] * len(floor))[j], 2),
                "state": rest.state_of(d, j)[1],
            }
            for floor in (d["noise_floor"],)
            for j, name in enumerate(d["joints"])
        ]
        return {"tables": tables, "refused": refused, "diagnostics": diagnostics, "two": "learnable_share" in d}


def _error_rows(d: Mapping[str, Any], of: str, split: str) -> list[dict[str, str]]:
    before, found, final = d[of][split]["before"], d[of][split]["after"], rest.final_errors(d, split, of)
    return [
        {
            "joint": with_unit(name, words.slides(d)),
            "before": words.number(before["rmse"][j]),
            "found": words.number(found["rmse"][j]),
            "final": words.number(final["rmse"][j]),
            "relative_before": words.share(before["relative_rmse"][j], 3),
            "relative_final": words.share(final["relative_rmse"][j], 3),
        }
        for j, name in enumerate(d["joints"])
    ]


def _pooled(d: Mapping[str, Any], of: str, split: str) -> str:
    errors = (d[of][split]["before"], rest.final_errors(d, split, of))
    return " → ".join(words.share(e["relative_error"], 3) for e in errors)


class Search(LoopSection):
    """The search step by step: which candidates competed and why one was taken."""

    title = "How it was found, step by step"
    name = "search"
    template = "search.html"

    @property
    def wanted(self) -> bool:
        return bool(self.content.steps)

    def values(self, book: FigureBook) -> dict[str, Any]:
        return {
            "steps": [
                {"title": f"{_numbers(first, len(own))}. {_title(own)}", "candidates": own[0].candidates}
                for first, own in _together(self.content.steps)
            ]
        }


def _together(steps: Sequence[SearchStep]) -> list[tuple[int, list[SearchStep]]]:
    """The number of the first step and the steps of every line: what was dropped one after the other is one line."""
    out: list[tuple[int, list[SearchStep]]] = []
    for number, step in enumerate(steps, 1):
        if out and step.action == "drop" and out[-1][1][0].action == "drop" and not step.candidates:
            out[-1][1].append(step)
        else:
            out.append((number, [step]))
    return out


def _numbers(first: int, count: int) -> str:
    return f"{first}" if count == 1 else f"{first} to {first + count - 1}"


def _title(steps: Sequence[SearchStep]) -> str:
    step = steps[0]
    if step.action == "start":
        return "start again from everything that the runs can carry, to prune it"
    if step.action == "stop":
        return "stop: none of these is worth adding"
    if step.action == "replace":
        return f"replace {' and '.join(step.replaced)} by {words.placed(step.effect, step.joint)}"
    return f"{step.action} {', '.join(words.placed(own.effect, own.joint) for own in steps)}"


def _worth(d: Mapping[str, Any], laws: Sequence[Law], joint: str) -> str:
    """What the formula for ``joint`` takes of the held-out error; nothing where it has not been tried."""
    for law in laws:
        if law.joint == joint and law.before > 0:
            ends = f"{words.padded(law.before)} → {words.padded(law.after)} {words.effort_unit(d, joint)}"
            part = words.share(1 - (law.after / law.before) ** 2)
            return f"takes {part} of the test runs' error (variance; rms {ends})"
    return ""


def _how_much(d: Mapping[str, Any], entry: Mapping[str, Any]) -> str:
    """Which share of what is left the state of the joint is about."""
    size = words.share(entry["share_of_residual_variance"])
    return {
        rest.ALARM: f"{words.share(rest.learned(d, entry))} can be learned from the motion",
        rest.SLOW: f"{size} changes slowly, or follows the motion by what may be chance",
        rest.PARTED: f"{size} is more than noise, or than the training runs leave",
        rest.HELD: f"{size} is there while the joint stands",
        **words.SURPASSED,
    }.get(rest.state_of(d, list(d["joints"]).index(entry["joint"]))[1], size)


class Reproduce(LoopSection):
    """Command, logs, version, settings and digests from which the page can be made again."""

    title = "Reproduce"
    name = "reproduce"
    template = "reproduce.html"

    def values(self, book: FigureBook) -> dict[str, Any]:
        known = dict(self.diagnosis.get("provenance") or {})
        command = known.pop("command", None)
        settings = known.pop("settings", {})
        return {
            "command": shell_line(command) if isinstance(command, Mapping) else command,
            "rows": list(_flat(known)),
            "settings": list(_flat(settings)),
            "train": self.content.train_runs,
            "test": self.content.test_runs,
            "origin": self.content.provenance,
            "schema": self.diagnosis["schema"],
        }


def shell_line(command: Mapping[str, Any]) -> str:
    """What to type to get the same again: a stage of the study, or the options of a command."""
    if "stage" in command:
        return f"dvc repro {command['stage']}"
    parts = ["hybrid-dynamics", str(command.get("command", "close-loop"))]
    for key, value in command.items():
        given = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        if key == "command" or value is False or given in ([None], []):
            continue
        parts += [f"--{key.replace('_', '-')}", *(shlex.quote(str(item)) for item in given if item is not True)]
    # Where the results went is not on record: the same inputs give the same bytes anywhere.
    return " ".join([*parts, "--out out"])


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    out: list[tuple[str, str]] = []
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            out += _flat(value, f"{name} · ")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            if any(isinstance(item, Mapping) for item in value):
                for item in value:
                    out += [
                        (
                            name,
                            ", ".join(f"{k} {v}" for k, v in item.items()) if isinstance(item, Mapping) else str(item),
                        )
                    ]
            else:
                out.append((name, ", ".join(map(str, value)) or "as they are by default"))
        else:
            out.append((name, str(value)))
    return out


#: The page of one loop, top to bottom.
LOOP_PAGE: tuple[type[LoopSection], ...] = (Answer, Effects, Evidence, Torque, Left, Errors, Search, Reproduce)
#: What the study's page shows of a loop.
STUDY_PART: tuple[type[LoopSection], ...] = (Answer, Effects, Evidence, Left)
