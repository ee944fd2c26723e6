"""Feed every reader of the package with many damaged and hostile files.

``python -m tests.fuzz --scale 100`` tries a hundred times as many inputs as the test suite, other
ones in each run. Hypothesis prints how to make a failing input again, and the file that it wrote
stays in pytest's temporary directory.
"""

import argparse
import os
import sys

import pytest

from tests.fuzz.readers import READERS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=int, default=10, help="multiplies the number of inputs")
    parser.add_argument("--reader", choices=READERS, nargs="*", default=list(READERS))
    arguments = parser.parse_args()
    os.environ["FUZZ_SCALE"] = str(arguments.scale)
    # The thread method also ends a reader that hangs in C code.
    options = [f"--timeout={300 * arguments.scale}", "--timeout-method=thread"]
    tests = [
        f"tests/test_fuzz.py::test_damaged_files_give_a_value_or_one_line[{name}]"
        for name in arguments.reader
    ]
    sys.exit(pytest.main([*options, *tests]))


if __name__ == "__main__":
    main()
