"""`make fuzz MINUTES=30`: damaged files of every format and JSON document, until the time is over.

    PYTHONPATH=tests/fuzz:tests/fixtures python tests/fuzz/run.py [--minutes 30] [--first-seed 0] [--cases N]
        [--keep FOLDER] [NAME...]

Prints a row for each seed file, and each fault with its number. `--keep` writes the files with faults to a
folder; a fault that is mended belongs into tests/fuzz/corpus. Exit code 1 if there is a fault.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from mutations import mutated
from runner import CONTAINED, FAULT, READ, REFUSED, preload, rounds
from seeds import seeds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=None, help="cases of each seed file, instead of a time")
    parser.add_argument("--keep", type=Path, default=None)
    parser.add_argument("names", nargs="*", help="names of seed files; all without a name")
    given = parser.parse_args()
    preload()
    end_s = None if given.cases else time.monotonic() + 60.0 * given.minutes
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        chosen = [seed for seed in seeds(folder) if not given.names or seed.name in given.names]
        tallies = {}
        for number, tallies in rounds(chosen, folder, given.first_seed, given.cases, end_s):
            found = sum(len(tally.faults) for tally in tallies.values())
            cases = (number - given.first_seed) * len(chosen)
            print(f"\r{cases} files, {found} faults", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        print(f"{'file':28} {READ:>8} {REFUSED:>8} {CONTAINED:>10} {FAULT:>6} {'slowest':>9} {'memory':>8}")
        for seed in chosen:
            tally = tallies[seed.name]
            counts = [tally.counts[result] for result in (READ, REFUSED, CONTAINED, FAULT)]
            print(
                f"{seed.name:28} {counts[0]:8} {counts[1]:8} {counts[2]:10} {counts[3]:6} "
                f"{tally.slowest_s:7.2f} s {tally.most_bytes / 1e6:5.0f} MB"
            )
        for seed in chosen:
            for number, reason in tallies[seed.name].faults:
                print(f"\n{seed.name} {number}: {reason}")
                if given.keep is not None:
                    given.keep.mkdir(exist_ok=True)
                    target = seed.damaged or seed.path
                    content = mutated(
                        target.read_bytes(),
                        f"{seed.name} {number}",
                        is_text=seed.is_text,
                        is_json=seed.is_json,
                    )
                    (given.keep / f"{number}_{target.name}").write_bytes(content)
    return int(any(tally.faults for tally in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
