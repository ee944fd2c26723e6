"""What the command line says to people, to logs and to programs."""

import inspect
import io
import os
import pty
import re
import select
import shlex
import subprocess
import sys
import time
import typing
from pathlib import Path

import pytest
from rich.console import Console

from ailsrs_jax.cli import main as cli
from ailsrs_jax.cli import terminal
from tests.cli.test_cli import ailsrs

SEARCH = "num_directions=4 num_top_directions=2 episode_length=20"
TRAIN = f"train tests.point_mass:PointMass --algorithm ars --set {SEARCH}"


@pytest.mark.parametrize(
    ("arguments", "nearest"),
    {
        "trian hopper": "train",
        "train hoper": "hopper",
        "train Walkr2d-v5": "Walker2d-v5",
        "train hopper --algorithm gial": "gail",
        "train hopper --set nose_std=0.1": "noise_std",
        "expert hopper --output e.npz --set lerning_rate=1": "learning_rate",
    }.items(),
)
def test_typos_are_told_the_nearest(
    arguments: str, nearest: str, in_tmp_path: Path, monkeypatch, capsys
) -> None:
    assert ailsrs(monkeypatch, *arguments.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"(did you mean {nearest}?)" in line


def test_a_mistyped_option_is_told_the_nearest(monkeypatch, capsys) -> None:
    assert ailsrs(monkeypatch, "train", "hopper", "--rseume") == 2
    assert "--resume" in capsys.readouterr().err


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_explains_itself(name: str, monkeypatch, capsys) -> None:
    command = cli.COMMANDS[name]
    assert f"Example: ailsrs {name} " in inspect.getdoc(command)
    monkeypatch.setenv("COLUMNS", "60")
    assert ailsrs(monkeypatch, name, "--help") == 0
    text = capsys.readouterr().out
    assert "\x1b" not in text
    assert "None" not in text
    options = text[text.index("--help") :]
    assert {"--quiet", "--json"} <= set(options.split())
    assert max(map(len, options.splitlines())) <= 60
    for argument, kind in typing.get_type_hints(command, include_extras=True).items():
        shared = any(getattr(note, "help", None) for note in getattr(kind, "__metadata__", ()))
        documented = re.search(rf"^    {argument}: \S", inspect.getdoc(command), re.MULTILINE)
        assert shared or documented or argument in ("terminal", "return"), argument


def test_the_command_is_written_as_a_shell_reads_it(monkeypatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/nowhere/bin/ailsrs", "train", "--output", "it's here"])
    words = ["/nowhere/bin/ailsrs", "train", "--output", "it's here", "--resume"]
    assert shlex.split(terminal.this_command("--resume")) == words
    monkeypatch.setattr(sys, "argv", ["/a/ailsrs_jax/__main__.py", "merge"])
    assert shlex.split(terminal.this_command()) == [sys.executable, "-m", "ailsrs_jax", "merge"]


def test_json_has_no_nan(capsys) -> None:
    fields = {"a": [float("nan"), 1.5], "b": {"c": float("-inf")}, "d": (1, None)}
    terminal.Terminal(as_json=True).json(fields)
    assert "".join(capsys.readouterr().out.split()) == (
        '{"a":[null,1.5],"b":{"c":null},"d":[1,null]}'
    )


def test_bash_completes(tmp_path: Path) -> None:
    script = (
        subprocess.run(
            [sys.executable, "-m", "ailsrs_jax", "--tyro-print-completion", "bash"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        + """
        for words in "ailsrs swe" "ailsrs train --res" "ailsrs train hopper --no-such"; do
            COMP_WORDS=($words) COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMPREPLY=()
            _tyro_ailsrs
            echo "found: ${COMPREPLY[*]}"
        done
        """
    )
    printed = subprocess.run(
        ["bash", "-c", script], check=True, capture_output=True, text=True, cwd=tmp_path
    ).stdout
    assert printed.splitlines() == ["found: sweep", "found: --resume", "found: "]


@pytest.mark.slow  # two processes that compile
def test_interrupted_in_a_narrow_terminal_and_resumed_by_what_it_says(in_tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ailsrs_jax", *TRAIN.split(), "--iterations", "100000"]
    code, printed = in_terminal([*command, "--output", "it's here"], "/100000", columns=40)
    assert code == 130
    lines = printed.replace("\r\n", "\n").split("\n")
    drawn = [
        re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", part).removesuffix("^C")
        for part in re.split(r"[\r\n]+", printed)
    ]
    for shown in (r"\S \d+/100000 ", "seed 0  "):
        mine = [part for part in drawn if re.match(shown, part)]
        assert mine
        assert max(map(len, mine)) <= 40
    at = next(index for index, line in enumerate(lines) if line.endswith("saved; continue with:"))
    words = shlex.split(lines[at + 1])
    assert words == [*command, "--output", "it's here", "--resume"]
    before = (Path("it's here") / "metrics.csv").read_bytes()
    code, printed = in_terminal(words, "/100000", columns=80)
    assert code == 130
    assert (Path("it's here") / "metrics.csv").read_bytes().startswith(before)
    assert shlex.split(printed.splitlines()[-1]) == words


def in_terminal(command: list[str], until: str, columns: int) -> tuple[int, str]:
    """Run in a pseudo-terminal, press Ctrl-C when something is shown; exit code and output."""
    ours, theirs = pty.openpty()
    environment = os.environ | {
        "COLUMNS": str(columns),
        "TERM": "xterm",
        "PYTHONPATH": str(Path(cli.__file__).parents[2]),
    }
    process = subprocess.Popen(
        ["setsid", "--ctty", *command], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    os.close(theirs)
    printed, pressed = b"", False
    while process.poll() is None or select.select([ours], [], [], 0)[0]:
        try:
            printed += os.read(ours, 4096)
        except OSError:  # nobody has it open any longer
            break
        if not pressed and until.encode() in printed:
            pressed = True
            os.write(ours, b"\x03")
    code = process.wait(timeout=100)
    os.close(ours)
    return code, printed.decode()


def test_a_long_stage_says_how_far_it_is(monkeypatch, capsys) -> None:
    assert terminal.SECONDS_IN_A_LOG <= 15
    monkeypatch.setattr(terminal, "SECONDS_IN_A_LOG", 0.01)
    with terminal.Terminal().stage("rendering") as watch:
        watch(3, 8)
        time.sleep(0.3)
    first, *between, last = capsys.readouterr().out.splitlines()
    assert first == "rendering"
    assert "rendering: 3 of 8 pictures" in between
    assert re.fullmatch(r"rendering took \d+\.\d s", last)

    screen = io.StringIO()
    shown = terminal.Terminal()
    vars(shown)["console"] = Console(file=screen, force_terminal=True, width=80)
    with shown.stage("rendering") as watch:
        watch(3, 8)
    assert "rendering: 3 of 8 pictures" in screen.getvalue()
