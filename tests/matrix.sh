#!/usr/bin/env bash
# Each supported Python that is here gets a fresh environment, in which the package is installed,
# trains three iterations on both engines, and runs the notebooks.
#
# usage: tests/matrix.sh [--others]     (--others: without the version of python3, which `make test` has)
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export XDG_CACHE_HOME=$work/cache
summary=()

check() { # PYTHON JAX
    if ! "$1" -c "" 2>/dev/null; then  # pyenv has commands for versions that are off
        summary+=("$1 with $2: this Python is not here")
        return
    fi
    if [[ $others && $("$1" -V) == $(python3 -V) ]]; then
        summary+=("$1 with $2: make test has this Python")
        return
    fi
    local bin=$work/venv/bin output=$work/run
    "$1" -m venv --clear "$work/venv"
    "$bin/pip" install --quiet --disable-pip-version-check ".[minari]" "$2" \
        ipykernel nbclient pytest pytest-timeout pytest-xdist
    for physics in mujoco mjx; do
        "$bin/ailsrs" train hopper --num-trajectories 1 --physics $physics --iterations 3 \
            --set num_directions=4 num_top_directions=2 episode_length=20 \
            num_evaluation_episodes=2 --quiet --output "$output"
        rm -r "$output"
    done
    "$bin/python" -m pytest -q -n 0 -m '' tests/test_notebooks.py \
        tests/trainers/parts/test_sharing.py tests/test_versions.py
    summary+=("$("$bin/python" -V) with $("$bin/pip" list 2>/dev/null | grep -E '^jax ' | tr -s ' '): passed")
}

others=
[[ ${1:-} == --others ]] && others=yes
check python3.11 'jax<0.10'
check python3.11 jax
check python3.12 jax
check python3.13 jax
printf '%s\n' "${summary[@]}"
