"""Wrong input: one line on standard error, exit code 2, and nothing written."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_cli import ailsrs

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def broken_file(kind: str) -> Path:
    path = Path(f"{kind}.npz")
    arrays = {
        "observations": np.zeros((2, 5, 11)),
        "actions": np.zeros((2, 5, 3)),
        "lengths": np.array([5, 5]),
        "returns": np.zeros(2),
        "env_id": np.array("Hopper-v5"),
    }
    if kind == "shapes":
        arrays["actions"] = np.zeros((2, 5, 4))
    elif kind == "nan":
        arrays["observations"][1, 1, 1] = np.nan
    elif kind == "pickled":
        arrays["observations"] = np.array([[[object()]]])
    elif kind == "other_task":
        arrays["env_id"] = np.array("Walker2d-v5")
    elif kind == "other_sizes":
        arrays["observations"] = np.zeros((2, 5, 17))
    elif kind == "ragged":
        arrays["observations"] = np.array([[0.0], [0.0, 0.0]], dtype=object)
    elif kind == "no_steps":
        arrays |= {"observations": np.zeros((0, 5, 11)), "actions": np.zeros((0, 5, 3))}
    elif kind == "out_of_range":
        arrays["actions"][1, 1, 1] = 1.1
    elif kind == "thinned_states":
        del arrays["actions"]
        arrays["stride"] = np.array(2)
    if kind == "text":
        path.write_text("observations, actions\n")
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind != "missing":
        np.savez(path, **arrays)
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    return path


@pytest.mark.parametrize(
    "kind",
    [
        *["missing", "text", "empty", "truncated", "shapes", "nan", "pickled", "ragged"],
        *["no_steps", "other_task", "other_sizes", "out_of_range", "thinned_states"],
    ],
)
def test_bad_demonstrations(kind: str, monkeypatch, capsys) -> None:
    path = broken_file(kind)
    before = sorted(Path().iterdir())
    code = ailsrs(monkeypatch, "train", "hopper", "--demonstrations", path, "--num-trajectories", 2)
    one_line_and_nothing_written(code, capsys, before)


@pytest.mark.parametrize(
    "arguments",
    [
        "train hoper",
        "train nowhere:Slider",
        "train tests.point_mass:PointMass",
        "train tests.point_mass:PointMass --demonstrations file --physics mjx",
        "expert tests.point_mass:nothing --output expert.npz",
        "demonstrate tests.point_mass:PointMass --output demonstrations.npz",
        "train hopper --preset tuned --set noise=1",
        "train hopper --set noise_std",
        "train hopper --iterations 0",
        "train hopper --iterations 3 --set num_iterations=5",
        "train hopper --seeds 1 1",
        "train hopper --seeds 3 --seeds 3",
        "train hopper --seeds 2147483648",
        "train hopper --physics bullet",
        "train hopper --preset best",
        f"train hopper --output {'x' * 300}",
        "evaluate missing.npz --seed -1",
        f"evaluate {'x' * 300}",
        f"demonstrate hopper --num-trajectories 1 --output {'x' * 300}/d.npz",
        "demonstrate hopper --seed -1 --output demonstrations.npz",
        "expert hopper --seed -1 --output expert.npz",
        "train hopper --num-trajectories 0",
        "train hopper --num-trajectories 2000000000",
        "train swimmer --num-trajectories 1 --subsample 0",
        "train swimmer --num-trajectories 1 --subsample 20 --set episode_length=10",
        "train hopper --demonstrations minari:",
        "train hopper --demonstrations empty",
        f"train hopper --demonstrations {'x' * 300}",
        "train hopper --rollout-batch-size 0",
        "train hopper --algorithm ars --set num_directions=3000000 --output run",
        "train hopper --track mlflow --output run",
        "train hopper --distributed",
        "train hopper --distributed --output run",
        f"inspect {'x' * 300}",
        "benchmark hoper",
        "sweep missing.toml",
        "sweep file",
        "sweep missing.toml --launcher slurm",
        "merge merged nowhere",
        "benchmark hopper --physics bullet",
        "benchmark hopper --repeats 0",
        "train hopper --resume",
        "train hopper --algorithm ars --resume --output nowhere",
        "train hopper --algorithm ars --output /proc/run",
        "train hopper --algorithm ars --output file/inside",
        "render missing.npz --output out.mp4",
        "render . --output out.mp4",
        "render file --output out.html",
        "render missing.npz --output out.gif",
        "render missing.npz --output file/out.mp4",
        "render missing.npz --output out.html --size 15",
        "render missing.npz --learning --output out.mp4",
        "render . --learning --output out.html",
        "render . --learning --alone --output out.mp4",
        "render . --learning --play --output out.html",
        "render missing.npz --play --output out.html",
        "render . --play --output out.mp4",
        "report missing",
        "report .",
        "report file",
        f"report {'x' * 300}",
        "report . --episodes 0",
        "evaluate missing.npz",
        "evaluate .",
        "evaluate file",
        "export missing.npz --output policy.onnx",
        "export file --output policy.onnx",
        "export empty --output policy.onnx",
        "demonstrate hopper --num-trajectories 0 --output demonstrations.npz",
        "demonstrate hopper --num-trajectories 1 --output /proc/demonstrations.npz",
        "demonstrate hopper --num-trajectories 1 --output fifo.npz",
        "demonstrate hopper --num-trajectories 2000000000 --output demonstrations.npz",
        "demonstrate hoper --output demonstrations.npz",
        "demonstrate hopper --output minari:hopper",
        "demonstrate hopper --output file/demonstrations.npz",
        "expert hoper --output expert.npz",
        "expert hopper --output file/expert.npz",
        "expert hopper --output fifo.npz",
        "expert hopper --output expert.pt",
        "expert hopper --set num_top_directions=1000 --output expert.npz",
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(arguments: str, monkeypatch, capsys) -> None:
    Path("file").write_text("in the way")
    Path("empty").mkdir()
    os.mkfifo("fifo.npz")
    before = sorted(Path().iterdir())
    code = ailsrs(monkeypatch, *arguments.split())
    one_line_and_nothing_written(code, capsys, before)


def one_line_and_nothing_written(code: int, capsys, before: list[Path]) -> None:
    errors = capsys.readouterr().err
    assert code == 2, errors
    assert errors.startswith("ailsrs: ")
    assert len(errors.splitlines()) == 1
    assert sorted(Path().iterdir()) == before
