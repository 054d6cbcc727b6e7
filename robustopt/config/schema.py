"""Writes the reference page of the configuration and its JSON Schema: `python -m robustopt.config.schema [FOLDER]`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from robustopt.config.model import Config
from robustopt.config.section import Section
from robustopt.config.words import choices, default, expected, fields, meaning, unit, unwrap

PAGE, SCHEMA = "configuration.md", "robustopt.schema.json"

_INTRODUCTION = """\
# Configuration

Every key of a configuration, generated from the package by `python -m robustopt.config.schema`.

A configuration is one YAML file in SI units and radians. Unknown keys are errors. Keys without a default must be
given. Names of files are relative to the configuration. For completion and checks in an editor, put this into the
first line of a file (the path is relative to the file):

```yaml
# yaml-language-server: $schema=../docs/robustopt.schema.json
```

**Overrides.** `key=value` arguments replace any value, the value in YAML; keys are joined by dots and entries of lists
are numbered from 0. Sections on the way are made where they are missing, and a whole section can be replaced:

```sh
robustopt plan configs/waiter_two_blocks.yaml contact.friction=0.3 path.tray_poses.0.yaw=-0.5 'uncertainty={}'
```

**Precedence.** An override wins over the file. Where an interval is given under `uncertainty`, the plan holds for all
of it and the point value only has to lie in it; a point value outside is an error. The sections `execution` and
`learning` are checked by every command; `plan` does not read them.

**YAML.** Only `true` and `false` are booleans, so `on` is a plain key. `1e-3` is a number, `1_000` is text.

**Frames.** The tray frame has its origin at the tray's centre and its z axis out of the face that carries the objects.
An object's frame has its origin at the object's centre and its z axis along the tray's.
"""


def sections(model: type[Section] = Config, name: str = "") -> Iterator[tuple[str, type[Section]]]:
    """All sections of the configuration with their names, such as `path.tray_poses[]`, in the order of the keys."""
    yield name, model
    for key, annotation in fields(model).items():
        inner = f"{name}.{key}" if name else key
        for option in choices(annotation):
            base, _ = unwrap(option)
            if get_origin(base) is dict:
                base, inner = get_args(base)[1], f"{inner}.NAME"
            elif get_origin(base) is tuple and isinstance(get_args(base)[0], type):
                base, inner = get_args(base)[0], f"{inner}[]"
            if isinstance(base, type) and issubclass(base, Section):
                yield from sections(base, inner)


def page() -> str:
    """The reference page in Markdown."""
    parts = [_INTRODUCTION]
    for name, model in sections():
        title = f"`{name}`" if name else "Top level"
        rows = "".join(_row(model, key) for key in fields(model))
        parts.append(f"## {title}\n\n| key | type | unit | default | meaning |\n|---|---|---|---|---|\n{rows}")
    return "\n".join(parts)


def _row(model: type[Section], key: str) -> str:
    info, annotation = model.model_fields[key], fields(model)[key]
    kind = expected(annotation, info.metadata).split(" with the keys")[0]
    cells = [f"`{key}`", kind, unit(info), _default(info), meaning(info)]
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def _default(info: Any) -> str:
    value = default(info)
    if info.is_required():
        return "required"
    if value is None:
        return "none"
    if isinstance(value, Section):
        return "see below"
    return f"`{json.dumps(value)}`"


def json_schema() -> dict[str, Any]:
    """JSON Schema of a configuration file, for editors."""
    schema = Config.model_json_schema()
    del schema["properties"]["folder"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "robustopt configuration",
        "description": "Configuration of a task of robustopt",
    }


def files() -> dict[str, str]:
    """Contents of the generated files, by name."""
    return {PAGE: page(), SCHEMA: json.dumps(json_schema(), indent=1) + "\n"}


def main() -> None:
    """Write the files into a folder, `docs` by default."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files().items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
