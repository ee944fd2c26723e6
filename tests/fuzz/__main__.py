"""Feed every reader of the package with many damaged and hostile files.

``python -m tests.fuzz --scale 100`` tries a hundred times as many inputs as the test suite, other
ones in each run. Hypothesis prints how to make a failing input again, and the file that it wrote
stays in pytest's temporary directory.
"""

import argparse
import os
import subprocess
import sys

from tests.fuzz.readers import READERS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=int, default=10, help="multiplies the number of inputs")
    parser.add_argument("--reader", choices=READERS, nargs="*", default=list(READERS))
    arguments = parser.parse_args()
    environment = os.environ | {"FUZZ_SCALE": str(arguments.scale)}
    # The thread method also ends a reader that hangs in C code.
    options = [f"--timeout={300 * arguments.scale}", "--timeout-method=thread"]
    tests = [
        f"tests/test_fuzz.py::test_damaged_files_give_a_value_or_one_line[{name}]"
        for name in arguments.reader
    ]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    sys.exit(subprocess.run(command, env=environment, check=False).returncode)


if __name__ == "__main__":
    main()
