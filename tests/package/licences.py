"""Licences of the Rust crates that are compiled into the wheel.

    python tests/package/licences.py           verify that every licence is permitted
    python tests/package/licences.py --write   write THIRD_PARTY_LICENSES, which the wheel contains

The crates are those of the dependency graph of imucal-py without development and build dependencies. Needs
cargo, which downloads the sources of all crates.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOTICE = ROOT / "THIRD_PARTY_LICENSES"
# Permitted licences, in the order in which one is chosen if a crate offers several. All allow distribution
# in a wheel under MIT or Apache-2.0, with their texts.
PERMITTED = [
    "MIT",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "Zlib",
    "Unicode-3.0",
    "Unlicense",
]
# Words in the names of the files that contain the text of a licence; `license` alone is any of them.
FILE_WORDS = {
    "MIT": ["mit"],
    "Apache-2.0": ["apache"],
    "Apache-2.0 WITH LLVM-exception": ["apache", "llvm"],
    "BSD-2-Clause": ["bsd"],
    "BSD-3-Clause": ["bsd"],
    "Zlib": ["zlib"],
    "Unicode-3.0": ["unicode"],
    "Unlicense": ["unlicense"],
}


def crates():
    """Name, version, licence expression and folder of each crate in the wheel, by name and version."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    metadata = json.loads(done.stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    (first,) = (key for key, package in packages.items() if package["name"] == "imucal-py")
    reached, pending = set(), [first]
    while pending:
        key = pending.pop()
        if key not in reached:
            reached.add(key)
            pending += [
                dependency["pkg"]
                for dependency in nodes[key]["deps"]
                if any(kind["kind"] is None for kind in dependency["dep_kinds"])
            ]
    found = [packages[key] for key in reached if packages[key]["source"] is not None]
    return sorted(
        (
            (
                package["name"],
                package["version"],
                package["license"] or "",
                Path(package["manifest_path"]).parent,
            )
            for package in found
        ),
        key=lambda crate: crate[:2],
    )


def chosen(expression):
    """The licences that apply, one of each group of alternatives; raises ValueError if a group has none."""
    licences = []
    for group in re.split(r"\s+AND\s+", expression):
        offered = [each.strip() for each in re.split(r"\s+OR\s+|/", group.strip("()"))]
        fitting = [licence for licence in PERMITTED if licence in offered]
        if not fitting:
            raise ValueError(f"{group.strip('()')} is not permitted")
        licences.append(fitting[0])
    return licences


def text_of(folder, licence):
    """The text of a licence in the sources of a crate, or its standard text; empty if there is none."""
    files = sorted(
        file
        for file in folder.iterdir()
        if file.is_file() and re.match(r"(licen[cs]e|copying|unlicense)", file.name, re.IGNORECASE)
    )
    named = [file for file in files if any(word in file.name.lower() for word in FILE_WORDS[licence])]
    plain = [
        file for file in files if re.fullmatch(r"(licen[cs]e|copying)(\.\w+)?", file.name, re.IGNORECASE)
    ]
    for file in [*named, *plain]:
        return "\n".join(line.rstrip() for line in file.read_text(encoding="utf-8").strip().splitlines())
    if licence == "MIT":
        # The permission is the same in every MIT licence, after the line of the copyright.
        text = (ROOT / "LICENSE-MIT").read_text(encoding="utf-8")
        return "Copyright (c) the authors of the crate\n\n" + text[text.index("Permission is") :].strip()
    return ""


def notice():
    """The content of THIRD_PARTY_LICENSES."""
    parts = [
        "The compiled extension of imucal contains these Rust crates, each under the licence named here.\n"
        "The text of a licence stands after the last crate to which it applies. Written by\n"
        "tests/package/licences.py --write.\n"
    ]
    by_text = {}
    for name, version, expression, folder in crates():
        for licence in chosen(expression):
            text = text_of(folder, licence) or f"(the sources contain no text of the licence {licence})"
            by_text.setdefault((licence, text), []).append(f"{name} {version}: {licence}")
    for (_, text), names in sorted(by_text.items(), key=lambda item: item[1]):
        parts.append("\n".join(["=" * 100, *names, "=" * 100, "", text, ""]))
    return "\n".join(parts)


def main():
    wrong = []
    for name, version, expression, _ in crates():
        try:
            chosen(expression)
        except ValueError as error:
            wrong.append(f"{name} {version}: {error}")
    if wrong:
        print("\n".join(wrong))
        return 1
    if "--write" in sys.argv:
        NOTICE.write_text(notice(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
