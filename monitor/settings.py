"""All settings of the chain in one tree, and its TOML: what `monitor settings` prints and `--settings` reads.

Each step declares its own settings (see `monitor.declare`); here they are gathered. Every default needs no thought;
"auto" means that the value is found from the data and recorded with the result.
"""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
from pathlib import Path
from typing import Any

from monitor.comparison import CompareSettings
from monitor.filtering import FilterSettings
from monitor.reconstruction import SurfaceSettings
from monitor.registration import IcpSettings
from monitor.registration.network.adjustment import AdjustmentSettings
from monitor.registration.parts import PartSettings
from monitor.registration.targets.finding import TargetSettings
from projects.errors import ParameterError

AUTO = "auto"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the whole chain."""

    filter: FilterSettings = dataclasses.field(default_factory=FilterSettings)
    targets: TargetSettings = dataclasses.field(default_factory=TargetSettings)
    adjust: AdjustmentSettings = dataclasses.field(default_factory=AdjustmentSettings)
    surface: SurfaceSettings = dataclasses.field(default_factory=SurfaceSettings)
    icp: IcpSettings = dataclasses.field(default_factory=IcpSettings)
    compare: CompareSettings = dataclasses.field(default_factory=CompareSettings)
    parts: PartSettings = dataclasses.field(default_factory=PartSettings)


def read_settings(path: Path | None) -> Settings:
    """Return the settings of a TOML file laid over the defaults; the defaults where no file is given."""
    if path is None:
        return Settings()
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ParameterError(f"--settings {path}: cannot be read ({why})") from error
    except tomllib.TOMLDecodeError as error:
        raise ParameterError(f"--settings {path}: not valid TOML ({error})") from error
    except RecursionError as error:
        raise ParameterError(f"--settings {path}: is nested too deeply for settings") from error
    return _overlay(Settings(), table, str(path))


def _overlay(settings: Any, table: dict[str, Any], where: str) -> Any:
    """Return the dataclass `settings` with the values of `table`, checked name by name."""
    fields = {f.name: f for f in dataclasses.fields(settings)}
    changed: dict[str, Any] = {}
    for name, value in table.items():
        if name not in fields:
            close = difflib.get_close_matches(name, fields, n=1)
            hint = f"; did you mean {close[0]}?" if close else f"; allowed are {', '.join(fields)}"
            raise ParameterError(f"{where}: there is no setting {name}{hint}")
        present = getattr(settings, name)
        if dataclasses.is_dataclass(present):
            if not isinstance(value, dict):
                raise ParameterError(f"{where}: {name} is a group of settings, not a value")
            changed[name] = _overlay(present, value, f"{where}: [{name}]")
        else:
            changed[name] = _value(value, fields[name], f"{where}: {name}")
    try:
        return dataclasses.replace(settings, **changed)
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from error


def _value(value: Any, field: dataclasses.Field[Any], where: str) -> Any:
    """Return one value as its field's type, or raise."""
    if value == AUTO:
        if field.default is not None:
            raise ParameterError(f"{where} cannot be {AUTO}; its default is {_toml_value(field.default)}")
        return None
    wanted = type(field.default) if field.default is not None else float
    if wanted is float and type(value) is int:
        return float(value) if field.default is not None else value
    if type(value) is not wanted and not (field.default is None and isinstance(value, int | float | str)):
        like = "a number" if field.default is None else f"a value like {_toml_value(field.default)}"
        raise ParameterError(f"{where} = {_told(value)}: {like} is needed")
    return value


def _told(value: Any) -> str:
    """Return a value of a TOML file as it may stand there."""
    return _toml_value(value) if isinstance(value, bool | int | float | str) else str(value)


def as_mapping(settings: Any) -> dict[str, Any]:
    """Return nested settings as plain values, as they are recorded with a step."""
    return dataclasses.asdict(settings)


def to_toml() -> str:
    """Return every setting with unit, default and meaning as TOML that `--settings` reads."""
    lines = ['# Settings of heritage-monitor. Every default needs no thought; "auto" is found from the data.']
    _write_table(Settings(), "", lines)
    return "\n".join(lines) + "\n"


def _write_table(settings: Any, prefix: str, lines: list[str]) -> None:
    """Append one table and its sub-tables."""
    plain = [f for f in dataclasses.fields(settings) if not dataclasses.is_dataclass(getattr(settings, f.name))]
    if prefix and plain:
        summary = (type(settings).__doc__ or "").strip().splitlines()[0]
        lines += ["", f"# {summary}", f"[{prefix}]"]
    for f in plain:
        meta = f.metadata
        allowed = f" Allowed: {', '.join(meta['choices'])}." if meta.get("choices") else _range_text(meta)
        unit = f" [{meta['unit']}]" if meta.get("unit") else ""
        lines.append(f"# {meta.get('meaning', '').strip().rstrip('.')}.{unit}{allowed}")
        lines.append(f"{f.name} = {_toml_value(getattr(settings, f.name))}")
    for f in dataclasses.fields(settings):
        value = getattr(settings, f.name)
        if dataclasses.is_dataclass(value):
            _write_table(value, f"{prefix}.{f.name}" if prefix else f.name, lines)


def _range_text(meta: Any) -> str:
    """Return the allowed range as words, empty where there is none."""
    low, high = meta.get("low"), meta.get("high")
    if low is None and high is None:
        return ""
    if high is None:
        return f" At least {low}."
    return f" At most {high}." if low is None else f" {low} to {high}."


def _toml_value(value: Any) -> str:
    """Return one value as TOML."""
    if value is None:
        return f'"{AUTO}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)
