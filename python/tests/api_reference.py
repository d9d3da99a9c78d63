"""Prints docs/reference/python-api.md: signatures of the stubs and sources, docstrings of the package."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import gripcast
import gripcast._client

SOURCES = Path(__file__).resolve().parent.parent / "gripcast"
# What the private names of types stand for.
ALIASES = {
    "_Floats32": "NDArray[float32]",
    "_Floats": "NDArray[float64]",
    "_Image": "NDArray[uint8]",
    "_Depth": "NDArray[uint16]",
    "_Array": "NDArray[float32]",
    "_Matrix": "ArrayLike",
    "_Path": "str | PathLike[str]",
    "_Side": 'Literal["left", "right"]',
    "_Stage": 'Literal["initial", "grasp"]',
    "_Outcome": 'Literal["stable", "slip", "unlabelled"]',
    "_Role": 'Literal["left", "right", "rgb", "depth", "external"]',
    "_Vector": "tuple[float, float, float]",
    "_Range": "tuple[float, float]",
    "_Step": "tuple[NDArray[float32], float, bool, bool, dict[str, Any]]",
}
GROUPS = {
    "Objects and grasps": ["Mesh", "Object", "Placement", "GraspPose", "GraspCase", "Pose"],
    "Simulation": [
        "simulate", "simulate_batch", "press", "Simulation", "SimulationState", "GraspResult", "Snapshot", "FaceFields",
        "PressResult",
    ],
    "Rendering": ["render_tactile", "render_visual", "SensorProfile", "SensorFit", "TactileImage", "VisualImage"],
    "Prediction": ["Predictor", "Prediction", "LiftVerdict"],
    "Gel markers": ["track_markers", "MarkerTrack"],
    "Marker boards": ["detect_markers", "solve_pose", "Board", "BoardPose", "Marker", "Intrinsics"],
    "Datasets": ["Dataset", "Grasp", "VerifyReport", "Problem"],
    "A running daemon": ["Client", "DaemonState", "Event", "Events", "LiveFrame", "LiveMarkers"],
    "Environments": ["GraspEnv", "GraspVectorEnv"],
    "Errors": [
        "Error", "AccessError", "BusyError", "ConfigError", "InputError", "InternalError", "IoError", "NotFoundError",
        "RefusedError", "UnreachableError", "UsageError",
    ],
}  # fmt: skip
HEAD = """# Python API

Generated from the package's stubs and docstrings (`python/tests/api_reference.py`); a test compares this page with the package. [Use gripcast from Python](../how-to/python.md) has a quick start. Lengths are metres and forces newtons; names carry the unit. A pose `t_a_b` maps coordinates of frame b into frame a. Images are height × width × 3, uint8, RGB. Frames: [conventions](../../ARCHITECTURE.md).

Every function raises a subclass of [`Error`](#error) with `what`, `where` and `remedy`; Ctrl-C ends long calls with `KeyboardInterrupt`. Long calls release the GIL.
"""
Definition = ast.ClassDef | ast.FunctionDef
Node = Definition | ast.AnnAssign


def definitions() -> dict[str, Definition]:
    found: dict[str, Definition] = {}
    for name in ("_native.pyi", "_client.py", "_errors.py", "gym.py"):
        for node in ast.parse((SOURCES / name).read_text()).body:
            if isinstance(node, Definition):
                found.setdefault(node.name, node)
    return found


def readable(text: str) -> str:
    text = text.replace("npt.", "").replace("np.", "").replace("gc.", "")
    for alias, meaning in ALIASES.items():
        text = re.sub(rf"(?<!\w){alias}(?!\w)", meaning, text)
    return text.replace("'", '"')


def signature(node: ast.FunctionDef, name: str, bound: bool) -> str:
    arguments = node.args
    positional = [*arguments.posonlyargs, *arguments.args]
    defaults = [None] * (len(positional) - len(arguments.defaults)) + list(arguments.defaults)
    parts = []
    for index, (argument, default) in enumerate(zip(positional, defaults)):
        if not (bound and index == 0):
            parts.append((argument, default, ""))
    texts = [one(*part) for part in parts]
    if arguments.vararg:
        texts.append(one(arguments.vararg, None, "*"))
    elif arguments.kwonlyargs:
        texts.append("*")
    texts += [one(a, d, "") for a, d in zip(arguments.kwonlyargs, arguments.kw_defaults)]
    if arguments.kwarg:
        texts.append(f"**{arguments.kwarg.arg}")
    result = f" -> {readable(ast.unparse(node.returns))}" if node.returns and name != "__new__" else ""
    line = f"({', '.join(texts)}){result}"
    return line if len(line) <= 90 else "(\n    " + ",\n    ".join(texts) + f",\n){result}"


def one(argument: ast.arg, default: ast.expr | None, stars: str) -> str:
    kind = f": {readable(ast.unparse(argument.annotation))}" if argument.annotation else ""
    if isinstance(default, ast.Name):
        # A constant of the module.
        default = ast.Constant(getattr(gripcast._client, default.id))
    value = f"{' = ' if kind else '='}{readable(ast.unparse(default))}" if default else ""
    return f"{stars}{argument.arg}{kind}{value}"


def decorators(node: ast.FunctionDef) -> list[str]:
    return [ast.unparse(decorator) for decorator in node.decorator_list]


def text_of(owner: object, node: Node, name: str) -> str:
    """Docstring of a definition: that of its source, else that of the native module."""
    own = ast.get_docstring(node) if isinstance(node, Definition) else None
    if own is None and owner is not None:
        value = getattr(owner, name, None)
        own = inspect.getdoc(value) if value is not None else None
    return own or ""


def paragraphs(text: str) -> Iterator[str]:
    """Paragraphs; indented lists stay as they are."""
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        head, *rest = paragraph.split("\n")
        if any(line.startswith("  ") for line in rest):
            yield " ".join(line for line in [head, *rest] if not line.startswith("  "))
            yield "```text\n" + inspect.cleandoc("\n".join(line for line in rest if line.startswith("  "))) + "\n```"
        else:
            line = " ".join(line.strip() for line in [head, *rest])
            keys = keyed(line)
            yield "\n".join(f"- `{key}`: {text}" for key, text in keys.items()) if keys else line


def keyed(paragraph: str) -> dict[str, str]:
    """Meanings by name of a paragraph like `a: the one; b and c: the others. More of them`."""
    found: dict[str, str] = {}
    names: list[str] = []
    for piece in re.split(r"(?<=[;.]) ", paragraph):
        match = re.match(r"((?:\w+, )*\w+(?: and \w+)?): (.*)", piece)
        if match:
            names = re.split(r", | and ", match[1])
            found.update(dict.fromkeys(names, match[2]))
        elif names:
            found.update({name: f"{found[name]} {piece}" for name in names})
        else:
            return {}
    return {name: text.rstrip(";.") for name, text in found.items()}


def block(code: str, text: str) -> list[str]:
    return ["", "```python", code, "```", *(f"\n{paragraph}" for paragraph in paragraphs(text) if paragraph)]


def cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def members(node: ast.ClassDef, owner: type | None, meanings: dict[str, str]) -> list[str]:
    rows, methods = [], []
    for child in node.body:
        if isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            # `metadata` is Gymnasium's.
            if not child.target.id.startswith("_") and child.target.id != "metadata":
                kind = re.sub(r"^ClassVar\[(.*)\]$", r"\1", ast.unparse(child.annotation))
                values = getattr(owner, child.target.id, ())
                text = ", ".join(f"`{value}`" for value in values) if isinstance(values, tuple) else ""
                rows.append((child.target.id, kind, meanings.get(child.target.id, text)))
        elif isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
            text = text_of(owner, child, child.name)
            if "property" in decorators(child):
                rows.append((child.name, ast.unparse(child.returns) if child.returns else "", text))
            else:
                static = "staticmethod" in decorators(child)
                name = f"{node.name}.{child.name}" if static or "classmethod" in decorators(child) else child.name
                methods += block(f"{name}{signature(child, child.name, not static)}", text)
    lines = []
    if rows:
        lines += ["", "| attribute | type | meaning |", "| --- | --- | --- |"]
        lines += [f"| `{name}` | `{cell(readable(kind))}` | {cell(text)} |" for name, kind, text in rows]
    return lines + methods


def class_section(node: ast.ClassDef, owner: type | None) -> list[str]:
    text = text_of(None, node, "") or inspect.getdoc(owner) or ""
    fields = {c.target.id for c in node.body if isinstance(c, ast.AnnAssign) and isinstance(c.target, ast.Name)}
    meanings: dict[str, str] = {}
    lines = []
    for paragraph in re.split(r"\n\s*\n", text):
        keys = keyed(" ".join(paragraph.split()))
        if keys and keys.keys() <= fields:
            meanings |= keys
        else:
            lines += [f"\n{part}" for part in paragraphs(paragraph) if part]
    bases = [ast.unparse(base) for base in node.bases if ast.unparse(base) != "Exception"]
    if bases:
        lines += [f"\nBases: {', '.join(f'`{readable(base)}`' for base in bases)}."]
    made = [c for c in node.body if isinstance(c, ast.FunctionDef) and c.name in ("__new__", "__init__")]
    # A class that has no constructor says so when it is called.
    made = [c for c in made if "Never" not in ast.unparse(c.args)]
    if made and not isinstance(owner, type(None)) and not issubclass(owner, BaseException):
        lines += block(f"{node.name}{signature(made[0], '__new__', True)}", "")
    return lines + members(node, owner, meanings)


def page() -> str:
    known = definitions()
    lines = [HEAD.rstrip()]
    for group, names in GROUPS.items():
        lines += ["", f"## {group}"]
        for name in names:
            node = known[name]
            owner = getattr(gripcast, name, None)
            lines += ["", f"### {name}"]
            if isinstance(node, ast.ClassDef):
                lines += class_section(node, owner)
            else:
                lines += block(f"{name}{signature(node, name, False)}", text_of(gripcast, node, name))
    return "\n".join(lines) + "\n"


def listed() -> set[str]:
    return {name for names in GROUPS.values() for name in names}


if __name__ == "__main__":
    sys.stdout.write(page())
