#!/usr/bin/env python3
"""tools/lint-prose.py [--self-test] [FILE…]

Finds words that docs/glossary.md says not to use, in what users read: the Markdown files of docs/
and the project, `--help` (its snapshots), texts in the Rust sources (string literals of more than
one word, and the doc comments that become help), and the texts of the web page. Prints
`file:line: word -> term` and exits with 1 if there are any.

How the column is written stands at the top of the glossary.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GLOSSARY = ROOT / "docs/glossary.md"
FILES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "calib/README.md", "models/*.md",
         "docs/*.md", "tests/it/snapshots/help/*.snap", "src/*.rs", "crates/*.rs", "src/web/page/*")

RUST = re.compile(
    r"""(?P<comment>//[^\n]*|/\*.*?\*/)
      | b?r(?P<hashes>\#*)"(?P<raw>.*?)"(?P=hashes)
      | b?"(?P<text>(?:[^"\\]|\\.)*)"
      | '(?:[^'\\]|\\.[^']*)'""",
    re.X | re.S,
)
SCRIPT = re.compile(r"//[^\n]*|/\*.*?\*/|(?P<quote>[\"'`])(?P<text>(?:(?!(?P=quote))[^\\]|\\.)*)(?P=quote)", re.S)


def rules(glossary=None):
    """Pairs of a compiled pattern and the term to use instead."""
    found = []
    for line in (glossary or GLOSSARY.read_text()).splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) < 2 or cells[0] in ("term", "write") or set(cells[0]) <= {"-", " "}:
            continue
        term, words = cells[0], cells[-1]
        for pattern in re.findall(r"`([^`]*)`", words):
            found.append((re.compile(pattern.replace("\\|", "|"), re.I), term))
        words = re.sub(r"`[^`]*`|\*[^*]*\*|\([^)]*\)", "", words)
        for word in filter(None, (word.strip() for word in words.split(","))):
            text = r"\s+".join(map(re.escape, word.split()))
            found.append((re.compile(rf"(?<![\w-]){text}s?(?![\w])", re.I), term))
    return found


def lines_of(text, first):
    yield from ((first + number, line) for number, line in enumerate(text.split("\n")))


def markdown(text):
    """Prose: no code blocks, inline code or link targets."""
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            inside = not inside
        elif not inside:
            yield number, re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "``", line))


def literal(text, start, value, single):
    """A literal of more than one word; a line that ends with a backslash goes on in the next."""
    if single or re.search(r"\w\s+\w", value):
        number = text.count("\n", 0, start) + 1
        value = re.sub(r"`[^`]*`", "``", value)
        value = re.sub(r"\\\n\s*", " ", value)
        yield from lines_of(value, number)


def rust(text, path):
    tests = re.search(r"^#\[cfg\(test\)\]\s*\n(?:#\[[^\n]*\]\s*\n)*(?:pub )?mod \w+ \{", text, re.M)
    text = text[: tests.start()] if tests else text
    is_cli = "src/cli/" in path
    for match in RUST.finditer(text):
        comment = match["comment"]
        if comment is not None:
            if is_cli and comment.startswith("/// "):
                yield from literal(text, match.start(), comment[4:], True)
            continue
        value = match["raw"] if match["raw"] is not None else match["text"]
        if value is not None:
            yield from literal(text, match.start(), value, False)


def page(text, path):
    if path.endswith(".html"):
        for number, line in enumerate(text.splitlines(), 1):
            spoken = re.findall(r'(?:title|aria-label|alt|placeholder)="([^"]*)"', line)
            yield number, " ".join([re.sub(r"<[^>]*>?", " ", line), *spoken])
    elif path.endswith(".js"):
        for match in SCRIPT.finditer(text):
            if match["text"] is not None:
                yield from literal(text, match.start(), match["text"], False)


def prose(path, text):
    """The lines of a file that people read, with their numbers."""
    if path == "docs/glossary.md" or path.endswith("_test.rs") or "/tests/" in f"/{path}".replace("/tests/it/snapshots", ""):
        return ()
    if path.endswith(".md"):
        return markdown(text)
    if path.endswith(".rs"):
        return rust(text, path)
    if path.endswith(".snap"):
        return enumerate(text.splitlines(), 1)
    return page(text, path)


def check(names, found_rules, root=ROOT):
    faults = []
    for name in names:
        for number, line in prose(name, (root / name).read_text()):
            for pattern, term in found_rules:
                for match in pattern.finditer(line):
                    faults.append(f"{name}:{number}: {match[0].strip()} -> {term}")
    return faults


def self_test():
    found_rules = rules()
    assert len(found_rules) > 20, "the glossary has hardly any words not to use"
    bad = {
        "bad.md": "A picture of the gel.\n",
        "src/cli/bad.rs": "/// Folder of pictures that objects may wear\nfn f() {}\n",
        "crates/bad.rs": 'fn f() { Error::new("this is no mesh").remedy("mend \\\n   that"); }\n',
        "page.js": 'say("the picture is old");\n',
        "page.html": '<p title="rescue it">text</p>\n',
    }
    good = {
        "good.md": "An image. There is no other. `picture`\n```\npicture\n```\n",
        "src/cli/good.rs": "// A picture in a comment.\n/// Directory of texture images\nfn f() {}\n",
        "crates/good.rs": 'fn f() { key("picture"); Error::new("not a valid mesh: it is no longer there"); }\n'
        '#[cfg(test)]\nmod tests { const A: &str = "a picture here"; }\n',
        "page.js": "// a picture\nkey('picture');\n",
        "page.html": '<img src="picture of.png">\n',
    }
    with tempfile.TemporaryDirectory() as folder:
        for texts, expected in ((bad, True), (good, False)):
            for name, text in texts.items():
                path = Path(folder) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
                faults = check([name], found_rules, Path(folder))
                assert bool(faults) == expected, f"{name}: {faults}"
    lines = check(["docs/glossary.md"], found_rules)
    assert not lines, lines


def main(arguments):
    if arguments == ["--self-test"]:
        self_test()
        return 0
    names = arguments
    if not names:
        listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "--", *FILES], check=True, capture_output=True, text=True)
        names = [name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]
    faults = check(names, rules())
    for fault in faults:
        print(fault)
    if faults:
        print(f"{len(faults)} words that docs/glossary.md says not to use", file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
