#!/usr/bin/env python3
"""tools/docs.py check | stage FOLDER

check: every relative link and anchor of the Markdown files leads to something that exists, every
page of docs/ is in SUMMARY.md, every docs/NAME.md that code or scripts mention exists, and every
flag in a documented `gripcast` command is in the help of that command, every snake_case or CamelCase
name occurs in the sources, and every path of a source exists.

stage FOLDER: writes the sources of the book: the pages of docs/, the Markdown files of the project
as chapters, and reference pages generated from the help snapshots (command line), the snapshots of
`--json` outputs, the OpenAPI description and the schema of the replay report.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SNAPSHOTS = ROOT / "tests/it/snapshots"

# Chapters of the book that stand outside of docs/.
PROJECT = {
    "README.md": "README.md",
    "ARCHITECTURE.md": "project/ARCHITECTURE.md",
    "CONTRIBUTING.md": "project/CONTRIBUTING.md",
    "CHANGELOG.md": "project/CHANGELOG.md",
    "calib/README.md": "project/calib.md",
    "models/README.md": "project/models.md",
    "models/plans/README.md": "project/plans.md",
}
# Made by `stage`: pages of the repository do not link to them.
GENERATED = ("reference/cli.md", "reference/json-output.md", "reference/file-formats.md", "reference/openapi.md", "reference/replay-report.md")

# Names of third parties that no source of ours has.
EXTERNAL_NAMES = {"time_pre_grasping", "plastic_duc", "plastic_duck"}
NAME = re.compile(r"(?<![\w./-])(?:[a-z][a-z0-9]*(?:_[a-z0-9]+)+|(?:[A-Z][a-z0-9]+){2,})(?![\w./-])")
PATH = re.compile(r"(?<![\w./$-])(?:src|crates|tests|tools|packaging|examples|fuzz|calib|models)/[\w./-]+")

LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^( *)(```|~~~)")


def tracked(*patterns):
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return [name for name in names if (ROOT / name).is_file()]


def prose_lines(text):
    """Lines with their numbers, code blocks left out."""
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if FENCE.match(line):
            inside = not inside
        elif not inside:
            yield number, line


def anchors(text):
    """Anchors of a page's headings, as GitHub and mdbook make them."""
    found = set()
    for _, line in prose_lines(text):
        heading = re.match(r"#{1,6} +(.*)", line)
        if heading:
            title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading[1]).replace("`", "").strip().lower()
            slug = re.sub(r"[^\w\- ]", "", title).replace(" ", "-")
            count = 0
            while (name := f"{slug}-{count}" if count else slug) in found:
                count += 1
            found.add(name)
    return found


def links(text):
    for number, line in prose_lines(text):
        for match in LINK.finditer(re.sub(r"`[^`]*`", "", line)):
            target = match[1]
            if not re.match(r"[a-z][a-z+.-]*:", target):
                path, _, anchor = target.partition("#")
                yield number, path, anchor


def snapshot(path):
    """A snapshot without its header."""
    return path.read_text().split("---\n", 2)[2].rstrip("\n")


def help_sections():
    """Help texts by command, `sim grasp`; that of the program by the empty name."""
    sections = {"": snapshot(SNAPSHOTS / "help/gripcast.snap")}
    for path in sorted((SNAPSHOTS / "help").glob("*.snap")):
        parts = re.split(r"^===== gripcast (.*?)(?: \(hidden\))? =====\n", snapshot(path), flags=re.M)
        sections.update(zip(parts[1::2], parts[2::2]))
    return sections


def command_faults(page, text, sections):
    """Flags of commands in blocks and inline code that the help of the command does not have."""
    for match in re.finditer(r"(?:^|[\s`])gripcast((?: [a-z][a-z0-9-]*)*)((?:[^\n`|;&]|\\\n)*)", text):
        words = match[1].split()
        if "fuzz" in words or not words:
            continue
        while words and " ".join(words) not in sections:
            words.pop()
        name = " ".join(words)
        line = text.count("\n", 0, match.start(1)) + 1
        for flag in re.findall(r"(?<=\s)--[a-z][a-z-]*", match[2].split("  #")[0]):
            known = re.search(rf"^ +(?:-\w, )?{flag}\b(?!-)", sections[name], re.M)
            if not known and flag not in ("--help", "--version"):
                yield f"{page}:{line}: `gripcast {name}` has no flag `{flag}`"


def name_faults(page, text, names):
    """Names and paths in inline code that do not exist."""
    for number, line in prose_lines(text):
        for code in re.findall(r"`([^`]+)`", line):
            for name in NAME.findall(code):
                if name not in names and name not in EXTERNAL_NAMES:
                    yield f"{page}:{number}: no source has `{name}`"
            for path in PATH.findall(code):
                if not (ROOT / path).exists() and not re.search(r"/[A-Z]+\.", path):
                    yield f"{page}:{number}: `{path}` does not exist"


def source_names():
    """Identifiers of the sources, and their beginnings and ends, which docs give with an ellipsis."""
    names = set()
    for name in tracked("*.rs", "*.py", "*.toml", "*.js", "*.sh", "*.snap", "*.json", "*.service", "*.sbatch"):
        names.update(re.findall(r"[A-Za-z_]\w*", (ROOT / name).read_text(errors="replace")))
    pieces = set(names)
    for name in names:
        words = name.split("_")
        pieces.update("_".join(words[:count]) for count in range(2, len(words)))
        pieces.update("_".join(words[count:]) for count in range(1, len(words) - 1))
    return pieces


def check():
    faults = []
    names = source_names()
    pages = tracked("*.md")
    sections = help_sections()
    for page in pages:
        text = (ROOT / page).read_text()
        if page != "CHANGELOG.md":
            faults += command_faults(page, text, sections)
            faults += name_faults(page, text, names)
        for number, path, anchor in links(text):
            target = (ROOT / page).parent / path if path else ROOT / page
            inside = os.path.relpath(target, ROOT)
            where = f"{page}:{number}"
            if page == "docs/SUMMARY.md" and (inside[5:] in GENERATED or inside[5:] in PROJECT.values()):
                continue
            if not target.exists():
                faults.append(f"{where}: `{path}` does not exist")
            elif anchor and inside.endswith(".md") and anchor not in anchors(target.read_text()):
                faults.append(f"{where}: `{path}` has no heading `#{anchor}`")
    listed = {f"docs/{path}" for _, path, _ in links((ROOT / "docs/SUMMARY.md").read_text())}
    for page in pages:
        if page.startswith("docs/") and page != "docs/SUMMARY.md" and page not in listed:
            faults.append(f"docs/SUMMARY.md: `{page}` is not listed")
    for name in tracked("*.rs", "*.sh", "*.py", "*.toml", "*.service", "*.snap", "Makefile"):
        for number, line in enumerate((ROOT / name).read_text(errors="replace").splitlines(), 1):
            for mention in re.findall(r"\bdocs/[a-z/-]+\.(?:md|json)\b", line):
                if not (ROOT / mention).exists():
                    faults.append(f"{name}:{number}: `{mention}` does not exist")
    return faults


def staged_links(text, page):
    """Links of a page of the repository as they are in the book: to chapters, else plain text."""
    own = PROJECT.get(page, page.removeprefix("docs/"))

    def replace(match):
        label, target = match[1], match[2]
        if re.match(r"[a-z][a-z+.-]*:|#", target):
            return match[0]
        path, mark, anchor = target.partition("#")
        inside = os.path.normpath(os.path.join(os.path.dirname(page), path))
        chapter = PROJECT.get(inside) or (inside.removeprefix("docs/") if inside.startswith("docs/") else None)
        if chapter is None:
            return label if label.strip("`") == inside else f"{label} (`{inside}`)"
        return f"[{label}]({os.path.relpath(chapter, os.path.dirname(own))}{mark}{anchor})"

    return re.sub(r"\[((?:[^\]`]|`[^`]*`)*)\]\(([^)\s]+)\)", replace, text)


def cli_page():
    lines = ["# Command line", "", "Generated from `--help`. Exit codes: `man gripcast`, section EXIT STATUS.", ""]
    for name, text in help_sections().items():
        level = "###" if " " in name else "##"
        lines += [f"{level} {' '.join(['gripcast', name]).strip()}", "", "```text", text.strip("\n"), "```", ""]
    return "\n".join(lines)


def json_page():
    lines = [
        "# JSON output of commands",
        "",
        "What `--json` prints, one line per value: `path: types`. `[]` is an item of an array, `{}` a value of an object whose keys are data, `?` a key that is sometimes absent.",
        "",
    ]
    names = sorted(path.stem for path in (SNAPSHOTS / "json").glob("*.snap"))
    for name in names:
        lines += [f"## gripcast {name.replace('-', ' ')}", "", "```text", snapshot(SNAPSHOTS / f"json/{name}.snap"), "```", ""]
    return "\n".join(lines)


def files_page():
    lines = [
        "# Keys of files",
        "",
        "The files that people read or write, key by key, generated from files that tests hold against the program; one line per value: `path: types`. `[]` is an item of an array, `{}` a value of an object whose keys are data (roles, names of files), `?` a key that is sometimes absent. Keys that only some rigs write, such as `pose` and `truth`, are null or absent here. What they mean: [dataset format](dataset-format.md), [rig, sensor and board files](../project/calib.md), [model files](../project/models.md).",
        "",
    ]
    for path in sorted((SNAPSHOTS / "files").glob("*.snap")):
        lines += [f"## {path.stem}", "", "```text", snapshot(path), "```", ""]
    return "\n".join(lines)


def schema_type(schema):
    """A type in words, with links to schemas of the same page."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    for key in ("oneOf", "anyOf"):
        if key in schema:
            return " or ".join(dict.fromkeys(schema_type(option) for option in schema[key]))
    if "allOf" in schema:
        return " and ".join(schema_type(option) for option in schema["allOf"])
    if "enum" in schema:
        return " ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    kind = schema.get("type", "any")
    kinds = kind if isinstance(kind, list) else [kind]
    words = []
    for kind in kinds:
        if kind == "array" and "items" in schema:
            words.append(f"array of {schema_type(schema['items'])}")
        elif kind == "object" and isinstance(schema.get("additionalProperties"), dict):
            words.append(f"object of {schema_type(schema['additionalProperties'])}")
        else:
            words.append(str(kind))
    return " or ".join(words)


def cell(text):
    return " ".join(str(text).split()).replace("|", "\\|")


def schema_section(name, schema, level="##"):
    lines = [f"{level} {name}", ""]
    if schema.get("description"):
        lines += [cell(schema["description"]), ""]
    bodies = [schema, *schema.get("allOf", []), *schema.get("oneOf", [])]
    objects = [body for body in bodies if "properties" in body]
    for body in objects:
        lines += ["| key | type | meaning |", "| --- | --- | --- |"]
        for key, value in body["properties"].items():
            optional = "" if key in body.get("required", []) else " (optional)"
            lines.append(f"| `{key}` | {cell(schema_type(value))}{optional} | {cell(value.get('description', ''))} |")
        lines.append("")
    if not objects:
        lines += [cell(schema_type(schema)), ""]
    return lines


def openapi_page():
    description = json.loads(snapshot(SNAPSHOTS / "openapi.snap"))
    lines = ["# Routes and schemas of the API", "", "Generated from the OpenAPI description (`GET /api/openapi.json`). Who may call, limits and events: [HTTP API](api.md).", "", "## Routes", ""]
    lines += ["| route | summary | body | answers |", "| --- | --- | --- | --- |"]
    for path, item in description["paths"].items():
        for method, route in item.items():
            if not isinstance(route, dict):
                continue
            body = route.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema")
            answers = []
            for code, answer in sorted(route.get("responses", {}).items()):
                content = answer.get("content", {})
                kind = next(iter(content), "")
                schema = content.get(kind, {}).get("schema")
                if int(code) < 400 or code == "409":
                    answers.append(f"{code} {schema_type(schema) if schema and kind == 'application/json' else kind}".strip())
            codes = [code for code in sorted(route.get("responses", {})) if int(code) >= 400]
            text = ", ".join(answers) + (f"; errors {', '.join(codes)}" if codes else "")
            summary = route.get("summary") or route.get("description", "")
            lines.append(f"| `{method.upper()} {path}` | {cell(summary)} | {schema_type(body) if body else ''} | {cell(text)} |")
    lines += ["", "Bodies of errors: the schema of the error object below.", "", "# Schemas", ""]
    for name, schema in sorted(description["components"]["schemas"].items()):
        lines += schema_section(name, schema)
    return "\n".join(lines)


def report_page():
    schema = json.loads((ROOT / "docs/reference/replay-report.schema.json").read_text())
    lines = ["# Replay report", "", "`report.json` of `gripcast replay`, generated from its JSON schema (`docs/reference/replay-report.schema.json`). Scores are defined in [Replay grasps](../how-to/replay.md#scores).", ""]
    lines += schema_section("The report", {k: v for k, v in schema.items() if k not in ("$defs", "definitions")})
    for name, body in sorted((schema.get("$defs") or schema.get("definitions") or {}).items()):
        lines += schema_section(name, body)
    return "\n".join(lines)


def stage(folder):
    source = folder / "src"
    shutil.rmtree(folder, ignore_errors=True)
    for name in tracked("docs"):
        target = source / name.removeprefix("docs/")
        target.parent.mkdir(parents=True, exist_ok=True)
        if name.endswith(".md"):
            target.write_text(staged_links((ROOT / name).read_text(), name))
        else:
            shutil.copyfile(ROOT / name, target)
    shutil.move(source / "book.toml", folder / "book.toml")
    for name, chapter in PROJECT.items():
        target = source / chapter
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(staged_links((ROOT / name).read_text(), name))
    for page, make in zip(GENERATED, (cli_page, json_page, files_page, openapi_page, report_page)):
        (source / page).write_text(make() + "\n")


def main(arguments):
    match arguments:
        case ["check"]:
            faults = check()
            for fault in faults:
                print(fault)
            return 1 if faults else 0
        case ["stage", folder]:
            stage(Path(folder).resolve())
            return 0
    print("usage: tools/docs.py check | stage FOLDER", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
