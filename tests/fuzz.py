"""Seeded random configurations and model files: `python tests/fuzz.py SEED FIRST LAST [--compiled]`.

Every case must be accepted, or answered with an error of robustopt, in 10 s of computing time and 2 GB of memory. The
number of each case is printed before it is tried, so that a crash names it; then the seed and the number give it again.
"""

import json
import math
import os
import random
import re
import resource
import signal
import string
import sys
import tempfile
import traceback
import warnings
from copy import deepcopy
from pathlib import Path

from robustopt.config.load import load_config, resolved, with_values
from robustopt.config.schema import json_schema
from robustopt.errors import RobustOptError
from robustopt.models import MODELS
from robustopt.path import build_path
from robustopt.robot import load_robot

SECONDS, BYTES = 10.0, 2_000_000_000
CONFIGS = Path(__file__).parents[1] / "configs"
SCHEMA = json_schema()
NAMES = [f"{name}.yaml" for name in ("waiter_two_blocks", "waiter_bridge", "pick_suction", "pick_gripper")]
WALKERS = ["humanoid_step.yaml", "humanoid_tray.yaml"]
NUMBERS = [0, 1, -1, 0.0, -0.0, 0.5, 1e-300, 1e300, -1e300, 5e-324, 1e12, 1e-12, math.inf, -math.inf, math.nan, 10**300]
FILES = ["fifo", "/dev/zero", "/proc/kmsg", "/proc/version", "nowhere.csv", ".", "", "a\0b", "x" * 5000, "self.xml"]
ODD = [*NUMBERS, *FILES, None, True, [], {}, [[]], [None], {"": 1}, "default", "tray", "1 kg", "\ud800", [1e300] * 6]


# Configurations -------------------------------------------------------------------------------------------


def options(schema: dict) -> list[dict]:
    """The alternatives of a part of the schema, without references."""
    if "$ref" in schema:
        return options(SCHEMA["$defs"][schema["$ref"].rsplit("/", 1)[-1]])
    return [inner for choice in schema.get("anyOf", []) for inner in options(choice)] or [schema]


def spots(schema: dict, data: object, key: tuple = ()) -> list[tuple[tuple, dict]]:
    """Every key that the schema allows with its part of the schema; names and positions are those of the data."""
    found = [(key, schema)] if key else []
    for option in options(schema):
        inner = dict(option.get("properties", {}))
        if isinstance(option.get("additionalProperties"), dict):
            names = data if isinstance(data, dict) and data else ["ghost"]
            inner |= dict.fromkeys(names, option["additionalProperties"])
        items = option.get("prefixItems") or [option["items"]] if "items" in option or "prefixItems" in option else []
        inner |= dict(enumerate(items))
        for name, part in inner.items():
            found += spots(part, at(data, (name,)), (*key, name))
    return found


def at(data: object, key: tuple) -> object:
    """The value at a key, None if there is none."""
    for part in key:
        inside = part in data if isinstance(data, dict) else isinstance(data, list) and part in range(len(data))
        data = data[part] if inside else None  # type: ignore[index]
    return data


def put(data: object, key: tuple, value: object) -> None:
    """Put a value at a key; sections and lists on the way are made."""
    for part, following in zip(key, (*key[1:], None), strict=True):
        inner = value if following is None else [] if isinstance(following, int) else {}
        if isinstance(data, list) and isinstance(part, int):
            data += [deepcopy(inner)] * (part + 1 - len(data))
        elif not isinstance(data, dict):
            return
        if following is None or (isinstance(data, dict) and not isinstance(data.get(part), (dict, list))):
            data[part] = deepcopy(inner)
        data = data[part]


def typo(rng: random.Random, name: str) -> str:
    i, letter = rng.randrange(len(name) + 1), rng.choice([*string.ascii_lowercase, "_", " ", "ü", "0", "."])
    return rng.choice([name[:i] + letter + name[i:], name[: max(i - 1, 0)] + name[i:], name.upper(), letter])


def value(rng: random.Random, schema: dict, depth: int = 0) -> object:
    """A value that the schema allows, or one at or beyond a bound of it, or an odd one."""
    option = rng.choice(options(schema))
    bounds = [option[name] for name in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum") if name in option]
    if bounds and rng.random() < 0.8:
        bound = rng.choice(bounds)
        return rng.choice([bound, bound - 1, bound + 1, bound * (1 + 1e-15), bound * (1 - 1e-15), -bound])
    if "enum" in option and rng.random() < 0.7:
        return rng.choice(option["enum"])
    if depth < 4 and rng.random() < 0.7:
        if "properties" in option:
            needed = set(option.get("required", ())) if rng.random() < 0.8 else set()
            chosen = [name for name in option["properties"] if name in needed or rng.random() < 0.3]
            return {name: value(rng, option["properties"][name], depth + 1) for name in chosen}
        if isinstance(option.get("additionalProperties"), dict):
            return {
                rng.choice(["default", "tray", "all", "joint1", "lower"]): value(rng, option["additionalProperties"], 4)
            }
        items = (
            option.get("prefixItems") or [option["items"]] * rng.choice([0, 1, 2, 3, 6, 7])
            if "items" in option or ("prefixItems" in option)
            else []
        )
        if items:
            return [value(rng, item, depth + 1) for item in items]
    if option.get("type") in ("number", "integer") and rng.random() < 0.7:
        return rng.choice([rng.uniform(-2, 2), rng.randrange(5), *NUMBERS])
    return rng.choice(ODD)


def configuration(rng: random.Random, base: dict) -> dict:
    """A shipped configuration with one to three mistakes."""
    data = deepcopy(base)
    for _ in range(rng.choice([1, 1, 2, 3])):
        every = spots(SCHEMA, data)
        written = [(key, schema) for key, schema in every if at(data, key) is not None]
        key, schema = rng.choice(written if rng.random() < 0.7 else every)
        kind, before = rng.random(), at(data, key)
        if kind < 0.25 and isinstance(key[-1], str):
            put(data, (*key[:-1], typo(rng, key[-1])), value(rng, schema))
        elif kind < 0.35:
            put(data, key, None)
        elif kind < 0.4:
            put(data, key[:1], rng.choice(ODD))
        elif isinstance(before, (int, float)) and kind < 0.7:
            put(data, key, type(before)(rng.choice([0.1, 0.5, 0.9, 1.1, 2, 10, 100, -1, 0]) * before))
        else:
            put(data, key, value(rng, schema))
    return data


# Model files ----------------------------------------------------------------------------------------------

CHILDREN = {
    "mujoco": "worldbody worldbody worldbody worldbody asset default option size compiler actuator include custom",
    "custom": "numeric",
    "worldbody": "body body geom site replicate frame", "default": "joint geom", "actuator": "motor position",
    "body": "body body joint joint freejoint geom geom site inertial replicate frame attach composite",
    "replicate": "body geom replicate", "frame": "body geom", "asset": "mesh hfield texture model",
    "robot": "link joint link joint link joint", "link": "inertial collision visual", "collision": "geometry",
    "visual": "geometry", "geometry": "mesh box",
}  # fmt: skip
NAMED = {"name": "a b c d e f g flange joint1 robustopt_x"}
UNNAMED = ("mujoco", "worldbody", "asset", "default", "compiler", "option", "size", "custom", "actuator", "include",
           "inertial", "attach", "composite", "replicate", "freejoint")  # fmt: skip
VECTOR, NUMBER = "0|0 0|0 0 1|1 0 0|0.1 0.1 0.1|1 1 1", "1 0.5 0 -1 1e9"
FILE = "self.xml other.xml other.xml other.xml nowhere.stl nowhere.stl fifo"
ATTRIBUTES = {
    "joint": {"type": "hinge slide ball free", "axis": VECTOR, "pos": VECTOR, "range": "-1 1|1 -1|0.3 0.3|0 0",
              "damping": NUMBER, "frictionloss": NUMBER, "armature": NUMBER, "ref": NUMBER, "stiffness": NUMBER},
    "geom": {"type": "box sphere plane hfield mesh cylinder", "size": VECTOR, "mass": NUMBER, "mesh": "a b",
             "hfield": "a b", "density": NUMBER, "pos": VECTOR},
    "body": {"pos": VECTOR, "euler": VECTOR, "quat": "1 0 0 0|0 0 0 0", "gravcomp": NUMBER, "mocap": "true false"},
    "site": {"pos": VECTOR, "size": NUMBER}, "inertial": {"pos": VECTOR, "mass": NUMBER, "diaginertia": VECTOR},
    "replicate": {"count": "2 1000 100000000", "offset": VECTOR}, "frame": {"pos": VECTOR},
    "attach": {"model": "a b", "body": "a b", "prefix": "p q"},
    "composite": {"type": "cable", "count": "3 1 1|1e9 1 1"},
    "mesh": {"file": FILE, "filename": FILE, "scale": VECTOR, "vertex": "0 0 0 1 0 0 0 1 0 0 0 1"},
    "hfield": {"nrow": "2 10 100000", "ncol": "2 10 100000", "size": "1 1 1 1"}, "model": {"file": FILE},
    "texture": {"type": "2d cube", "builtin": "flat", "width": "8 100000", "height": "8 100000", "file": FILE},
    "include": {"file": FILE}, "option": {"timestep": NUMBER, "gravity": VECTOR}, "numeric": {"size": "1 4294967296"},
    "size": {"memory": "1M 100G", "nuserdata": "1 4294967296"}, "motor": {"joint": "a b", "gear": NUMBER},
    "position": {"joint": "a b", "kp": NUMBER, "forcerange": "-1 1|1 -1"}, "box": {"size": VECTOR},
    "compiler": {"angle": "radian degree", "meshdir": ". fifo", "settotalmass": NUMBER, "inertiafromgeom": "true auto"},
}  # fmt: skip
ODD_WORDS = "nan inf -inf 1e300 1e-300 -1 0 100000000 100G abc world &#46; &bad; package://a/b.stl ü 1,2 1e400"
ODD_WORDS = [*ODD_WORDS.split(), "", "x" * 5000, "0 0 0 0 0 0 0 0", "0x10", "1e300 1e300 1e300"]


def words(text: str) -> list[str]:
    return text.split("|") if "|" in text else text.split()


def attributes(rng: random.Random, name: str) -> str:
    given = ATTRIBUTES.get(name, {}) | ({} if name in UNNAMED else NAMED)
    chosen = {key: rng.choice(words(values)) for key, values in given.items() if rng.random() < 0.6}
    odd = {key: rng.choice(ODD_WORDS) for key in chosen if rng.random() < 0.04}
    return "".join(f' {key}="{word}"' for key, word in {**chosen, **odd}.items())


def element(rng: random.Random, name: str, depth: int = 0) -> str:
    inner = "".join(
        element(rng, rng.choice(CHILDREN[name].split()), depth + 1)
        for _ in range(rng.randrange(1, 5) if name in CHILDREN and depth < 6 else 0)
    )
    return f"<{name}{attributes(rng, name)}>{inner}</{name}>"


def urdf(rng: random.Random) -> str:
    """A chain of links, with odd numbers and sometimes odd names."""
    odd = [] if rng.random() < 0.3 else [rng.randrange(40) for _ in range(3)]
    numbers = iter(range(1000))

    def word(usual: str) -> str:
        return rng.choice([*ODD_WORDS, "link0", "joint1"]) if next(numbers) in odd else usual

    text = '<link name="flange0"/>'
    for k in range(rng.choice([1, 2, 6])):
        shape = rng.choice(['<box size="1 1 1"/>'] * 8 + [f'<mesh filename="{rng.choice(FILE.split())}"/>', ""])
        text += (
            f'<link name="flange{word(str(k + 1))}"><inertial><mass value="{word("1")}"/><inertia ixx="{word("1")}" '
            f'iyy="1" izz="{word("1")}" ixy="0" ixz="0" iyz="{word("0")}"/></inertial><collision><geometry>{shape}'
            f'</geometry></collision></link><joint name="{word(f"joint{k}")}" type="{word("revolute")}"><parent '
            f'link="{word(f"flange{k}")}"/><child link="flange{k + 1}"/><axis xyz="{word("0 0 1")}"/><limit '
            f'lower="{word("-1")}" upper="{word("1")}" effort="{word("1")}" velocity="{word("1")}"/></joint>'
        )
    return f'<robot name="r">{text}</robot>'


def edited(rng: random.Random, text: str) -> str:
    """A model file with some attributes replaced, elements added, or characters lost."""
    for _ in range(rng.choice([1, 1, 1, 2])):
        kind, parts = rng.random(), text.split('"')
        i = rng.randrange(1, len(parts), 2)
        if kind < 0.5:
            inner = parts[i].split() or [""]
            inner[rng.randrange(len(inner))] = rng.choice(ODD_WORDS)
            parts[i] = " ".join(inner)
            text = '"'.join(parts)
        elif kind < 0.8:
            place = text.index("<worldbody>") if "<worldbody>" in text else 0
            section = rng.choice(["asset", "worldbody", "actuator", "custom", "size", "compiler"])
            text = text[:place] + element(rng, section, 4) + text[place:]
        else:
            place = rng.randrange(len(text))
            text = text[:place] + text[place + rng.choice([1, 3, 40]) :]
    return text


def model(rng: random.Random, shipped: str) -> str:
    kind = rng.random()
    return element(rng, "mujoco") if kind < 0.3 else urdf(rng) if kind < 0.6 else edited(rng, shipped)


# Run ------------------------------------------------------------------------------------------------------


def case(seed: int, number: int, bases: dict[str, dict]) -> dict:
    """The configuration of a case; its model file is in the working directory."""
    rng = random.Random(f"{seed} {number}")
    if number % 3 == 0:
        Path("arm.xml").write_text(text := model(rng, (MODELS / "tx90l.xml").read_text()), encoding="utf-8")
        limits = {"velocity": 1.0, "acceleration": 1.0, "torque": 10.0}
        tools = re.findall(r'<(?:body|site|link) name="(\w+)"', text) or ["flange"]
        robot = {"model": "arm.xml", "tool": rng.choice(tools), "limits": {"all": limits}}
        return {"name": "fuzz", "robot": robot, "path": {"joints": [[0.0], [0.1]]}}
    return configuration(rng, bases[rng.choice(NAMES if rng.random() < 0.9 else WALKERS)])


def attempt(data: dict, compiled: bool) -> str:
    try:
        config = load_config(data, folder=".")
        if config.robot.model == "arm.xml":
            n = load_robot(config).n
            config = with_values(config, {"path.joints": [[0.0] * n, [0.1] * n]})
        if compiled:
            from robustopt.solvers import build_problem

            build_problem(config)
        elif config.path.steps is None:
            build_path(config, load_robot(config))
        else:
            load_robot(config)
    except RobustOptError as error:
        message = str(error)
        assert message.strip(), "an error without words"
        assert not any(sum(map(str.isdigit, word)) > 200 for word in message.split()), message
        return type(error).__name__
    return "accepted"


def main(seed: int, first: int, last: int, compiled: bool) -> int:
    warnings.simplefilter("ignore")
    bases = {name: json.loads(json.dumps(resolved(load_config(CONFIGS / name)))) for name in (*NAMES, *WALKERS)}
    for base in bases.values():
        base["solver"]["collocation_points"] = 20
    counts: dict[str, int] = {}
    if compiled:
        attempt(bases[NAMES[0]], True)  # compiled functions are made or loaded before the clock runs
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        os.mkfifo("fifo")
        Path("self.xml").write_text('<mujoco><asset><model name="a" file="self.xml"/></asset></mujoco>')
        Path("other.xml").write_text("<mujoco><worldbody><body name='a'/></worldbody></mujoco>")
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, used + BYTES))
        for number in range(first, last):
            print(f"case {number}", file=sys.stderr, flush=True)
            data = case(seed, number, bases)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)  # its signal ends the process
            try:
                result = attempt(data, compiled)
            except Exception:
                result = "FAILED"
                print(f"case {number} of seed {seed}: {traceback.format_exc(limit=-4)}{str(data)[:2000]}", flush=True)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            counts[result] = counts.get(result, 0) + 1
        os.chdir("/")
    print(counts)
    return counts.get("FAILED", 0)


if __name__ == "__main__":
    sys.exit(min(main(*map(int, sys.argv[1:4]), "--compiled" in sys.argv), 100))
