"""What a ``log.yaml`` says: how logs that are not ``time,q1..qn[,dq1..dqn],tau1..taun`` in SI units are read.

The same keys stand in ``conf/dataset/`` (``reader.log``) and, the most common of them, on the command line. What a key
does to the numbers: :mod:`~hybrid_dynamics.readers.described`.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_dynamics.errors import ConfigError, require

SIGNALS = ("q", "dq", "tau")
COLUMNS = ("time", *SIGNALS, "tau_commanded")
#: One sample's joints stand below each other, a number a line.
STACKED = "stacked"
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": " ", "auto": ""}
CLOCKS = ("recorded", "even", "velocity")
#: The controller added the weight of the links itself, beside the torque that was logged.
COMPENSATED = "compensated"
#: Factors to SI units. A torque in A needs ``torque_constant``.
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "q": {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi},
    "dq": {"rad/s": 1.0, "deg/s": math.pi / 180, "rev/s": 2 * math.pi, "rpm": 2 * math.pi / 60},
    "tau": {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Nmm": 1e-3, "A": 1.0, "mA": 1e-3},
}
CURRENT = ("A", "mA")
Value = str | int


@dataclass(frozen=True)
class PerJoint:
    """A number a joint (or one for all) for each signal; empty where nothing is to be done."""

    q: tuple[float, ...] = ()
    dq: tuple[float, ...] = ()
    tau: tuple[float, ...] = ()


@dataclass(frozen=True)
class LogDescription:
    """Keys of a ``log.yaml``; all may be left out.

    ``columns``: for ``time``, ``q``, ``dq``, ``tau`` (and ``tau_commanded``) a name with ``{i}`` (joint number from 1),
    ``{i0}`` (from 0) or ``{joint}`` (its name), a list of names, column numbers such as ``2-8``, or ``stacked`` (one
    sample's joints below each other). ``files``: which file holds a signal, where a run has several: ``{run}`` is the
    last part of the path that is given (``rec/first`` and ``{run}_q.txt``: ``rec/first_q.txt``); without it the name of
    a file in the folder that is given. ``joints``: order of the columns. ``delimiter`` (auto, comma, semicolon, tab,
    whitespace), ``header``, ``skip_rows`` (lines before the header or the first sample), ``rows`` [first, last] of the
    samples, from 1.

    ``units`` of ``time q dq tau`` (dq follows q); ``torque_constant`` [N m/A] where the torque is a current; ``rate``
    [Hz] where no column holds the time. ``clock``: ``recorded`` stamps, ``even`` (stamps jitter, samples do not), or
    ``velocity``: steps are whole ``tick`` [s], told from the change of position over the velocity. ``torque``: read the
    columns of ``measured`` or ``commanded`` torque. ``gravity``: whether the weight of the links is ``included`` in the
    torque or was ``compensated`` by the controller beside it, and is added as the URDF has it.

    ``motor_side`` signals pass the gear: motor = ``gear_matrix`` joint (or ``gear_ratio`` per joint), so that
    tau_joint = gear_matrix' tau_motor. Then joint value = sign * gain * value + offset (offset in SI units).
    ``torque_delay``, ``velocity_delay`` [s] by which a signal was recorded late. ``decimate``: keep every k-th sample
    behind a low-pass against aliasing. ``drop``: signals that serve the clock alone. ``no_torque``: joints whose torque
    nobody measured, with or without columns: they move, and nothing is said of their torque.
    """

    columns: dict[str, Value | list[Value]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    delimiter: str = "auto"
    header: bool = True
    skip_rows: int = 0
    rows: tuple[int, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    torque_constant: tuple[float, ...] = ()
    rate: float = 0.0
    clock: str = "recorded"
    tick: float = 0.0
    torque: str = "measured"
    gravity: str = "included"
    motor_side: tuple[str, ...] = ()
    gear_ratio: tuple[float, ...] = ()
    gear_matrix: tuple[tuple[float, ...], ...] = ()
    sign: PerJoint = field(default_factory=PerJoint)
    gain: PerJoint = field(default_factory=PerJoint)
    offset: PerJoint = field(default_factory=PerJoint)
    torque_delay: float = 0.0
    velocity_delay: float = 0.0
    decimate: int = 1
    drop: tuple[str, ...] = ()
    no_torque: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for key in self.columns:
            _known(f"log.columns.{key}", key, COLUMNS)
        for key in self.files:
            _known(f"log.files.{key}", key, COLUMNS)
        _known("log.delimiter", self.delimiter, tuple(DELIMITERS))
        _known("log.clock", self.clock, CLOCKS)
        _known("log.torque", self.torque, ("measured", "commanded"))
        _known("log.gravity", self.gravity, ("included", COMPENSATED))
        for key, unit in self.units.items():
            _known(f"log.units.{key}", key, tuple(UNITS))
            _known(f"log.units.{key}", unit, tuple(UNITS[key]))
        for name in self.motor_side:
            _known("log.motor_side", name, SIGNALS)
        for name in self.drop:
            _known("log.drop", name, ("dq",))
        require(self.skip_rows >= 0, f"log.skip_rows is {self.skip_rows}; expected 0 or more lines")
        require(
            not self.rows or (len(self.rows) == 2 and 1 <= self.rows[0] < self.rows[1]),
            f"log.rows is {list(self.rows)}; expected [first, last], counted from 1",
        )
        require(0 <= self.rate < 1e6, f"log.rate is {self.rate}; expected Hz, 0 where a column holds the time")
        require(0 <= self.tick < 0.5, f"log.tick is {self.tick}; expected seconds, such as 0.001")
        require(
            self.clock != "velocity" or self.tick > 0,
            "log.clock is velocity; expected also log.tick, the controller's period [s], such as 0.001",
        )
        require(1 <= self.decimate <= 1000, f"log.decimate is {self.decimate}; expected 1 (none) to 1000")
        for name in ("torque_delay", "velocity_delay"):
            require(abs(getattr(self, name)) < 10, f"log.{name} is {getattr(self, name)}; expected seconds below 10")
        require(
            not (self.gear_ratio and self.gear_matrix),
            "log.gear_ratio and log.gear_matrix are both given; give the matrix alone",
        )
        gear = bool(self.gear_ratio or self.gear_matrix)
        require(
            gear or not self.motor_side,
            f"log.motor_side is {list(self.motor_side)}; expected also log.gear_ratio or log.gear_matrix",
        )
        require(
            not gear or bool(self.motor_side),
            "log.gear_ratio or log.gear_matrix is given without log.motor_side; say which of q, dq, tau stand on the "
            "motor's side",
        )
        require(0.0 not in self.gear_ratio, f"log.gear_ratio is {list(self.gear_ratio)}; expected values other than 0")
        current = self.units.get("tau") in CURRENT
        require(
            current == bool(self.torque_constant),
            "log.units.tau is a current; expected also log.torque_constant [N m/A]"
            if current
            else "log.torque_constant is given; expected log.units.tau A or mA",
        )
        require(
            self.torque == "measured" or "tau_commanded" in self.columns,
            "log.torque is commanded; expected log.columns.tau_commanded",
        )
        for name, values in (("sign.q", self.sign.q), ("sign.dq", self.sign.dq), ("sign.tau", self.sign.tau)):
            require(all(v in (1.0, -1.0) for v in values), f"log.{name} is {list(values)}; expected 1 and -1")
        for name in SIGNALS:
            require(
                0.0 not in getattr(self.gain, name),
                f"log.gain.{name} is {list(getattr(self.gain, name))}; expected values other than 0",
            )

    def unit(self, signal: str) -> float:
        """Factor of ``signal`` to SI units; a velocity without a unit follows the position."""
        unit = self.units.get(signal)
        if unit is None and signal == "dq":
            unit = {"deg": "deg/s", "rev": "rev/s"}.get(self.units.get("q", "rad"), "rad/s")
        return UNITS[signal][unit] if unit is not None else 1.0


def _known(where: str, value: str, known: tuple[str, ...]) -> None:
    near = difflib.get_close_matches(value, known, 1)
    hint = f" (did you mean {near[0]!r}?)" if near and near[0] != value else ""
    require(value in known, f"{where}: {value!r} is unknown{hint}; expected one of {', '.join(known)}")


def load_description(path: str | os.PathLike[str]) -> LogDescription:
    """Read ``log.yaml``; raises :class:`ConfigError`, in one line, for what is unknown, of the wrong type or range."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    file = Path(path)
    try:
        # OmegaConf, not PyYAML: a hand-written 1e-3 is a number.
        content = OmegaConf.to_container(OmegaConf.load(file), resolve=True)
    except FileNotFoundError:
        raise ConfigError(f"{file}: no such file; give the path of a log.yaml") from None
    except (OmegaConfBaseException, YAMLError, UnicodeDecodeError, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigError(f"{file}: not readable as YAML ({reason}); expected keys such as columns, units") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{file}: expected keys such as columns, units; it holds {type(content).__name__}")
    return describe({str(key): value for key, value in content.items()}, str(file))


def describe(values: Mapping[str, Any], origin: str = "log") -> LogDescription:
    """A description from plain values; ``origin`` stands in front of every complaint (:class:`ConfigError`)."""
    from pydantic import TypeAdapter, ValidationError

    for where, given, kind in (("", values, LogDescription), *((f"{k}.", values.get(k), PerJoint) for k in PER_JOINT)):
        if isinstance(given, Mapping):
            known = tuple(f.name for f in dataclasses.fields(kind))
            for key in given:
                try:
                    _known(f"{where}{key}", str(key), known)
                except ConfigError as error:
                    raise ConfigError(f"{origin}: {error}") from None
    plain = {key: _listed(key, value) for key, value in values.items()}
    try:
        return TypeAdapter(LogDescription).validate_python(plain)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if not str(part).startswith(("list[", "str", "int")))
        raise ConfigError(
            f"{origin}: {where} is {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}; see docs/logs.md"
        ) from None
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from None


PER_JOINT = ("sign", "gain", "offset")
LISTS = ("joints", "torque_constant", "gear_ratio", "motor_side", "drop", "no_torque")


def _listed(key: str, value: Any) -> Any:
    """One number or name where a list may stand is a list of one."""
    if key in PER_JOINT and isinstance(value, Mapping):
        return {name: [v] if isinstance(v, int | float) else v for name, v in value.items()}
    return [value] if key in LISTS and isinstance(value, int | float | str) else value


def from_options(
    log: str | os.PathLike[str] | None = None,
    columns: str | None = None,
    units: str | None = None,
    torque: str | None = None,
) -> LogDescription | None:
    """The description that ``--log --columns --units --torque`` give together (None: none of them is given).

    ``columns`` such as ``q=actual_q_{i},tau=current_{i}``; ``units`` such as ``deg,ms,Nmm`` or ``dq=rpm``. What the
    command line says goes before what the file says.
    """
    description = load_description(log) if log is not None else LogDescription()
    changes: dict[str, Any] = {}
    if columns:
        changes["columns"] = {**description.columns, **_pairs("--columns", columns)}
    if units:
        changes["units"] = {**description.units, **_units(units)}
    if torque:
        changes["torque"] = torque
    if not changes:
        return description if log is not None else None
    try:
        return dataclasses.replace(description, **changes)
    except ConfigError as error:
        raise ConfigError(f"{'command line' if log is None else f'command line and {log}'}: {error}") from None


def _pairs(option: str, text: str) -> dict[str, str]:
    out = {}
    for pair in text.split(","):
        key, sign, value = pair.partition("=")
        if not (sign and key.strip() and value.strip()):
            raise ConfigError(
                f"{option} {text}: {pair!r} is no pair; expected such as q=actual_q_{{i}},tau=torque_{{i}}"
            )
        out[key.strip()] = value.strip()
    return out


def _units(text: str) -> dict[str, str]:
    """``deg,ms,Nmm`` or ``q=deg``: every unit belongs to one signal."""
    out = {}
    for word in filter(None, (part.strip() for part in re.split("[, ]", text))):
        key, sign, unit = word.partition("=")
        if sign:
            out[key] = unit
            continue
        owners = [signal for signal, known in UNITS.items() if word in known]
        if not owners:
            every = ", ".join(unit for known in UNITS.values() for unit in known)
            raise ConfigError(f"--units {text}: {word!r} is unknown; expected some of {every}")
        out[owners[0]] = word
    return out
