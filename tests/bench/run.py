"""Run every benchmark of this folder, one process each, and say which figures were reached.

Each `bench_*.py` prints its own lines `PASS|MISS|INFO  name: measured (figure)` and never fails for being
slow: speed is for people to judge, correctness for the tests.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of file names; all when none is given")
    wanted = parser.parse_args().names
    lines: list[str] = []
    broken: list[str] = []
    for path in sorted(Path(__file__).parent.glob("bench_*.py")):
        if wanted and not any(name in path.name for name in wanted):
            continue
        print(f"\n== {path.stem}", flush=True)
        with subprocess.Popen([sys.executable, str(path)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                print(line, end="", flush=True)
                if line.startswith(("PASS", "MISS")):
                    lines.append(line.rstrip())
        if process.returncode:
            broken.append(path.stem)
    print("\n== summary")
    print("\n".join(lines))
    reached = sum(line.startswith("PASS") for line in lines)
    print(f"{reached} figures reached, {len(lines) - reached} missed, {len(broken)} benchmarks broken: {broken}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
