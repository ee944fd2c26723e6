"""Every reader of the package, fed with damaged and hostile files.

``python -m tests.fuzz --inputs 100000`` divides so many inputs among the readers and prints a table
of what came out. Each must give a value or one line, within memory and time, write nothing outside
its directory, unpickle nothing and start nothing. An input is a function of its number, so that
``--reader NAME --first NUMBER --inputs 1`` makes the same again.
"""

import argparse
import sys
import time

from tests.fuzz.machinery import fuzz
from tests.fuzz.readers import READERS


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--reader", choices=READERS, nargs="*", default=list(READERS))
    arguments = parser.parse_args()
    total = sum(READERS[name].weight for name in arguments.reader)
    kinds = ("value", "refused", "traceback", "not one line", "outside", "hang", "crash")
    sys.stdout.write(
        f"{'reader':16s}{'inputs':>8s}" + "".join(f"{k:>14s}" for k in kinds) + "   s\n"
    )
    failed = False
    for name in arguments.reader:
        number = arguments.inputs * READERS[name].weight // total
        started = time.perf_counter()
        counts = fuzz(name, arguments.first, arguments.first + number, say)
        row = "".join(f"{counts[kind]:14d}" for kind in kinds)
        seconds = time.perf_counter() - started
        say(f"{name:16s}{counts.total():8d}{row}{seconds:6.0f}")
        failed |= counts.total() > counts["value"] + counts["refused"]
    sys.exit(failed)


if __name__ == "__main__":
    main()
