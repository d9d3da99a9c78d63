#!/usr/bin/env python3
"""Prints the licences of everything that is compiled into the binary.

Crates by `cargo metadata` for this machine, without those of tests and build scripts; C sources by
the licence files inside their crates. The same text for the same Cargo.lock.
"""

import json
import pathlib
import re
import subprocess
import sys

LICENCE_FILE = re.compile(r"(?i)^((licen[cs]e|copying|notice|unlicense)([-._].*)?|README\.ijg)$")
NO_TEXT = (".rs", ".py", ".c", ".h", ".toml", ".html", ".rtf")
RULE = "=" * 78


def compiled_crates():
    """Packages that the binary is linked from, by name and version."""
    host = re.search(r"host: (\S+)", subprocess.check_output(["rustc", "-vV"], text=True)).group(1)
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", host]
    metadata = json.loads(subprocess.check_output(command))
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    root = metadata["resolve"]["root"]
    wanted, waiting = set(), [root]
    while waiting:
        node = waiting.pop()
        for dependency in nodes[node]["deps"]:
            name = dependency["pkg"]
            normal = any(kind["kind"] is None for kind in dependency["dep_kinds"])
            macro = any("proc-macro" in target["kind"] for target in packages[name]["targets"])
            if normal and not macro and name not in wanted:
                wanted.add(name)
                waiting.append(name)
    chosen = [packages[name] for name in wanted]
    return sorted(chosen, key=lambda package: (package["name"], package["version"]))


def licence_files(package):
    """Licence files of a crate and of the C sources one or two folders below."""
    folder = pathlib.Path(package["manifest_path"]).parent
    files = [folder / package["license_file"]] if package["license_file"] else []
    for pattern in ("*", "*/*", "*/*/*"):
        files += [
            path
            for path in folder.glob(pattern)
            if path.is_file() and LICENCE_FILE.match(path.name) and path.suffix not in NO_TEXT
        ]
    return sorted(set(path.resolve() for path in files))


def main():
    texts = {}
    print("Libraries that are compiled into gripcast, and their licences. Beside them:")
    print("the Rust standard library, MIT OR Apache-2.0, https://www.rust-lang.org")
    for package in compiled_crates():
        licence = package["license"] or "licence file below"
        print(f"\n{RULE}\n{package['name']} {package['version']}: {licence}")
        if package["repository"]:
            print(package["repository"])
        files = licence_files(package)
        if not files:
            authors = ", ".join(package["authors"]) or "the authors of the crate"
            print(f"\nNo licence file in the crate; by {authors}. The texts stand elsewhere here.")
        for path in files:
            text = path.read_text(encoding="utf-8", errors="replace").strip()
            title = f"{package['name']} {package['version']}, {path.name}"
            first = texts.setdefault(" ".join(text.split()), title)
            print(f"\n--- {path.name}" + ("" if first == title else f": as that of {first}"))
            if first == title:
                print(text)


if __name__ == "__main__":
    sys.exit(main())
