"""A copy of the Rust workspace with the switches of a sample, and its test programs and extension module."""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path

from mutants.given import FIRST, IN_RUST, given_sites
from mutants.rust_sites import PATTERN, constants_of, rust_sites
from mutants.sites import MOST, REACHED, SWITCH, Site, applied

__all__ = ["RustCopy"]

CRATES = ("rust/imucal/src", "rust/imucal-core/src")
# Left out: tests, and the simulation, whose recordings take the place of measurements in tests.
LEFT_OUT = ("tests", "simulate")
MODULE = f"""//! Switch of deliberate errors.

use std::{{env::var, fs::OpenOptions, os::fd::AsRawFd, ptr::null_mut, sync::OnceLock}};

static SWITCH: OnceLock<(usize, Option<usize>)> = OnceLock::new();

unsafe extern "C" {{
    fn mmap(at: *mut u8, bytes: usize, protection: i32, flags: i32, file: i32, offset: i64) -> *mut u8;
}}

/// Whether the error with this number is on.
#[inline]
pub fn is_on(number: usize) -> bool {{
    let (own, reached) = *SWITCH.get_or_init(switch);
    if let Some(bytes) = reached {{
        unsafe {{ ((bytes + number) as *mut u8).write_volatile(1) }};
    }}
    own == number
}}

/// The number of the error that is on, and the address of the bytes of reached errors.
fn switch() -> (usize, Option<usize>) {{
    let number = var("{SWITCH}").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    let open = |path| OpenOptions::new().read(true).write(true).open(path).unwrap();
    let file = var("{REACHED}").ok().map(open);
    // Read and write, shared.
    let bytes = file.map(|file| unsafe {{ mmap(null_mut(), {MOST}, 3, 1, file.as_raw_fd(), 0) }} as usize);
    (number, bytes)
}}
"""
# Modules that are compiled only for tests.
ONLY_IN_TESTS = re.compile(r"#\[cfg\(test\)\]\s+(?:pub(?:\([^)]*\))? )?mod (\w+);")
BUILD = ["build", "--package", "imucal-py"]
END = re.compile(r"/\*(\d+)\*/\)")


class RustCopy:
    """The copy in `folder` of the workspace in `root`; `sites` are the errors that compile, by number.

    package  a copy of the Python package, whose extension module is that of this copy
    """

    def __init__(self, root: Path, folder: Path, package: Path) -> None:
        self.root, self.folder, self.package = root, folder, package
        self.sites: dict[int, Site] = {}

    def compile(self, seed: int, count: int) -> None:
        """Draw `count` errors that compile, and compile them."""
        sources = {path.relative_to(self.root).as_posix(): path.read_bytes() for path in self._sources()}
        drawn = _all_sites(sources, random.Random(seed))
        self.sites = given_sites(IN_RUST, sources)
        count += len(self.sites)
        random.Random(seed).shuffle(drawn)
        reserve = dict(enumerate(drawn, 1))
        # A check takes less time than a build, but does not find all errors.
        for command in (["check", "--lib", "--package", "imucal"], BUILD):
            while True:
                while len(self.sites) < count:
                    number = min(reserve)
                    self.sites[number] = reserve.pop(number)
                self._write()
                failed = self._failed(command)
                if not failed:
                    break
                for number in failed:
                    if number >= FIRST:
                        raise SystemExit(f"does not compile: {self.sites[number]}")
                    del self.sites[number]

    def test_programs(self) -> list[Path]:
        """The tests of both crates, compiled."""
        which = ["--lib", "--tests", "--package", "imucal", "--package", "imucal-core"]
        done = self._cargo("test", "--no-run", *which)
        messages = [json.loads(line) for line in done.stdout.splitlines()]
        return [Path(m["executable"]) for m in messages if m.get("executable") and m["profile"]["test"]]

    def extension(self) -> Path:
        """The compiled extension module of Python."""
        return Path(os.environ["CARGO_TARGET_DIR"]) / "release" / "lib_core.so"

    def _sources(self) -> list[Path]:
        paths = [path for crate in CRATES for path in sorted((self.root / crate).rglob("*.rs"))]
        of_tests = {own for path in paths for own in ONLY_IN_TESTS.findall(path.read_text())}
        return [
            path
            for path in paths
            if not {*path.relative_to(self.root).parts, path.stem}.intersection(LEFT_OUT, of_tests)
        ]

    def _write(self) -> None:
        for name in ("Cargo.toml", "Cargo.lock"):
            _replace(self.folder / name, (self.root / name).read_text())
        # Tests in Rust read the profiles of units.
        for folder in ("rust", "benches", "python"):
            for path in (self.root / folder).rglob("*"):
                if path.suffix in (".rs", ".toml", ".md", ".json") and path.is_file():
                    name = path.relative_to(self.root).as_posix()
                    sites = {n: site for n, site in self.sites.items() if site.path == name}
                    text = applied(path.read_bytes(), sites, PATTERN)
                    _replace(self.folder / name, _with_module(name, text))
        _replace(self.folder / "rust/imucal-core/src/mutant.rs", MODULE)

    def _failed(self, command: list[str]) -> set[int]:
        """Numbers of the errors that the compiler refuses."""
        done = self._cargo(*command, check=False)
        failed = set()
        others = []
        for line in done.stdout.splitlines():
            message = json.loads(line).get("message") or {}
            if message.get("level") == "error" and message.get("spans"):
                found = {n for span in message["spans"] if span["is_primary"] for n in [self._at(span)] if n}
                failed |= found
                if not found:
                    others.append(message["rendered"])
        if done.returncode and not failed:
            raise SystemExit("\n".join(others) or done.stderr)
        return failed

    def _at(self, span: dict) -> int | None:
        """The number of the innermost switch around a place."""
        path = self.folder / span["file_name"]
        data = path.read_bytes()
        text, at = data.decode(), len(data[: span["byte_start"]].decode())
        last = len(data[: span["byte_end"]].decode())
        for end in END.finditer(text):
            start = text.rfind("(if ", 0, text.rfind(f"mutant::is_on({end[1]})", 0, end.start()))
            if 0 <= start <= at and last <= end.end():
                return int(end[1])
        return None

    def _cargo(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
        command = ["cargo", *arguments, "--release", "--message-format", "json"]
        # An error that the compiler foresees, such as an overflow, is left to the tests.
        environment = {**os.environ, "RUSTFLAGS": "--cap-lints warn"}
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True)
        if check and done.returncode:
            raise SystemExit(done.stderr)
        return done


def _all_sites(sources: Mapping[str, bytes], chance: random.Random) -> list[Site]:
    constants: dict[str, str] = {}
    for source in sources.values():
        constants |= constants_of(source)
    return [site for path, source in sources.items() for site in rust_sites(path, source, constants, chance)]


def _with_module(name: str, text: str) -> str:
    if name == "rust/imucal-core/src/lib.rs":
        text = text.replace("#[cfg(test)]\nextern crate std;", "extern crate std;")
        return text.replace("\npub mod calibration;", "\npub mod mutant;\npub mod calibration;", 1)
    is_core = name.startswith("rust/imucal-core/src/")
    return text.replace("imucal_core::mutant", "crate::mutant") if is_core else text


def _replace(path: Path, text: str) -> None:
    """Write a file if its text changes, so that cargo compiles only what changed."""
    if not path.exists() or path.read_text() != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
